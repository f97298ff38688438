"""Q-networks: plain modules that map a batch of observations (batch, ...) to Q-values (batch, actions).

A network is any class that is constructed from an observation space (a Box) and a number of actions. The two here are
the paper's dueling network, and the same behind an attention layer over the observed vehicles. Inputs arrive
standardised (:class:`Standardised`), and whatever a network needs beyond that it does itself.
"""

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from itertools import pairwise

import gymnasium as gym
import torch
from torch import Tensor, nn

from agents.plugins import named

Network = Callable[[gym.spaces.Box, int], nn.Module]

HIDDEN = (256, 192, 128)  # widths of the shared layers in the paper
STREAM = (128, 128)  # hidden widths of the value stream and of the advantage stream in the paper
WIDTH, HEADS = 64, 2  # of the attention
CONSTANT = 1e-6  # an input with a smaller standard deviation counts as constant


def layers(widths: Sequence[int]) -> nn.Sequential:
    """Linear layers of these widths, each followed by a ReLU."""
    parts: list[nn.Module] = []
    for fan_in, fan_out in pairwise(widths):
        parts += [nn.Linear(fan_in, fan_out), nn.ReLU()]
    return nn.Sequential(*parts)


class Dueling(nn.Module):
    """Shared layers, then a value stream V and an advantage stream A: Q = V + A - mean A (Wang et al. 2016).

    The paper prints Q = V + A, in which V and A are defined only up to a constant; the code that it cites subtracts
    the mean, as is done here.
    """

    def __init__(
        self, inputs: int, actions: int, hidden: Sequence[int] = HIDDEN, stream: Sequence[int] = STREAM
    ) -> None:
        super().__init__()
        self.base = layers((inputs, *hidden))
        self.value = nn.Sequential(layers((hidden[-1], *stream)), nn.Linear(stream[-1], 1))
        self.advantage = nn.Sequential(layers((hidden[-1], *stream)), nn.Linear(stream[-1], actions))

    def forward(self, x: Tensor) -> Tensor:
        """Q-values (batch, actions) of features (batch, inputs)."""
        base = self.base(x)
        advantage = self.advantage(base)
        return self.value(base) + advantage - advantage.mean(1, keepdim=True)


class DuelingMLP(Dueling):
    """The paper's network (256, 192, 128, streams of 2 x 128) on the flattened observation."""

    def __init__(self, space: gym.spaces.Box, actions: int) -> None:
        super().__init__(math.prod(space.shape), actions)

    def forward(self, x: Tensor) -> Tensor:
        """Q-values (batch, actions) of observations (batch, ...)."""
        return super().forward(x.flatten(1))


class EgoAttention(nn.Module):
    """The ego attends to the vehicles around it (Leurent and Mercat 2019), then the paper's layers decide.

    Each vehicle, a row of the observation with the ego first, is encoded by itself; the ego's code asks, and the answer
    does not depend on the order of the others. Rows of zeros are no vehicles and get no weight.

    With a single query the projection of the keys can be merged into that of the query, and the projection of the
    values into that of the output, so that neither is applied to every vehicle.

    Raises ValueError for observations that are not (vehicles, features).
    """

    def __init__(self, space: gym.spaces.Box, actions: int, width: int = WIDTH) -> None:
        super().__init__()
        if len(space.shape) != 2:
            raise ValueError(f"Attention needs observations (vehicles, features), got shape {space.shape}")
        self.ego = layers((space.shape[1], width, width))
        self.others = layers((space.shape[1], width, width))
        self.query = nn.Linear(width, HEADS * width, bias=False)
        self.output = nn.Linear(HEADS * width, width, bias=False)
        self.decision = Dueling(width, actions, HIDDEN[1:])

    def forward(self, x: Tensor) -> Tensor:
        """Q-values (batch, actions) of observations (batch, vehicles, features)."""
        return self.decision(self.features(x))

    def features(self, x: Tensor) -> Tensor:
        """What the decision is made of (batch, width): the mean of the ego's code and of the attention's answer."""
        ego, vehicles, weights = self._attend(x)
        answer = self.output((weights @ vehicles).flatten(1))
        return (answer + ego) / 2

    def _attend(self, x: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The ego's code, those of all vehicles, and the weights of each of them (batch, heads, vehicles)."""
        ego = self.ego(x[:, 0])
        vehicles = torch.cat([ego[:, None], self.others(x[:, 1:])], 1)
        query = self.query(ego).unflatten(1, (HEADS, -1))
        scores = query @ vehicles.transpose(1, 2) / math.sqrt(vehicles.shape[2])
        absent = (x == 0).all(2)
        absent[:, 0] = False  # the ego is always there
        return ego, vehicles, scores.masked_fill(absent[:, None], -torch.inf).softmax(2)


class Standardised(nn.Module):
    """A network behind inputs that are standardised with a fixed mean and standard deviation.

    They are stored with the weights. Before :meth:`fit` inputs pass unchanged. In observations (vehicles, features) the
    first row is the ego with statistics of its own, the other rows share theirs, and rows of zeros (no vehicle) stay
    zeros; in other observations each entry has its own.
    """

    mean: Tensor
    deviation: Tensor

    def __init__(self, network: nn.Module, space: gym.spaces.Box) -> None:
        super().__init__()
        self.network = network
        self.register_buffer("mean", torch.zeros(space.shape))
        self.register_buffer("deviation", torch.ones(space.shape))

    def forward(self, x: Tensor) -> Tensor:
        """What the network says of the standardised observations."""
        standardised = (x - self.mean) / self.deviation
        if x.ndim == 3:
            standardised = standardised * (x != 0).any(2, keepdim=True)
        return self.network(standardised)

    def fit(self, observations: Tensor) -> None:
        """Take mean and standard deviation from observations (n, ...); constant inputs are left as they are."""
        if observations.ndim == 3:
            for rows in (slice(0, 1), slice(1, None)):
                vehicles = observations[:, rows].flatten(0, 1)
                self._set(rows, vehicles[(vehicles != 0).any(1)])
        else:
            self._set(slice(None), observations)

    def _set(self, rows: slice, samples: Tensor) -> None:
        if len(samples) < 2:
            return
        mean, deviation = samples.mean(0), samples.std(0)
        varies = deviation > CONSTANT
        self.mean[rows] = torch.where(varies, mean, 0.0)
        self.deviation[rows] = torch.where(varies, deviation, 1.0)


def flatten(module: nn.Module) -> Tensor:
    """All parameters of a module in one vector, of which the module's own become views, as do their gradients."""
    parameters = list(module.parameters())
    vector = nn.Parameter(nn.utils.parameters_to_vector(parameters).detach().clone())
    vector.grad = torch.zeros_like(vector)
    start = 0
    for parameter in parameters:
        end = start + parameter.numel()
        parameter.data = vector.data[start:end].view_as(parameter)
        parameter.grad = vector.grad[start:end].view_as(parameter) if parameter.requires_grad else None
        start = end
    return vector


def unflattened(module: nn.Module) -> nn.Module:
    """A copy of a module with parameters of its own and without gradients."""
    copy = deepcopy(module).requires_grad_(False)
    for parameter in copy.parameters():
        parameter.data, parameter.grad = parameter.data.clone(), None
    return copy


NETWORKS: dict[str, Network] = {"attention": EgoAttention, "dueling": DuelingMLP}


def network_class(name: str) -> Network:
    """The network of this name: "attention", "dueling", or "FILE:CLASS" for a class in a file of one's own.

    Raises ValueError when there is no such network.
    """
    return named("network", name, NETWORKS)
