"""Double DQN on the attention network, compiled: what `agents.dqn` does with torch, two to three times as fast."""

import sys
from functools import cache
from itertools import accumulate
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from agents.greedy import Greedy
from agents.kernels import BASE, EGO, OTHERS, PARTS, WIDTH, Pass, approach, backward, descend, forward
from agents.models import HEADS, EgoAttention, Standardised, flatten
from agents.replay_memory import Batch


@cache
def announce() -> None:
    """Say that the network is compiled, unless the machine code is on the disk."""
    folder = forward.stats.cache_path
    if not (folder and [*Path(folder).glob("kernels.forward-*.nbi")]):
        text = "agents: Numba compiles the network, once for this installation ..."
        print(text, file=sys.stderr, flush=True)


class ByHand:
    """The updates of a double DQN whose networks are `EgoAttention` behind standardised inputs, on the CPU.

    online, target: the networks, whose weights lie in one vector each: weights, target_weights.
    """

    def __init__(self, online: nn.Module, target: nn.Module, weights: Tensor, target_weights: Tensor) -> None:
        self.online, self.target = Passes(online, weights), Passes(target, target_weights)
        assert weights.grad is not None
        self._gradient = weights.grad.numpy()
        self._weights, self._target_weights = weights.detach().numpy(), target_weights.detach().numpy()

    def update(
        self,
        batch: Batch,
        adam: dict[str, Tensor],
        limits: tuple[Tensor, Tensor] | None,
        max_norm: float,
        rate: float,
        tau: float,
    ) -> tuple[float, np.ndarray]:
        """One update, see `DQN.update`; returns the loss, and the goals before they were clipped.

        adam: its state as torch keeps it, empty in the beginning. limits: of the goals (n,), None for none.
        """
        observations, actions, rewards, after, discounts, _ = (part.numpy() for part in batch)
        count = len(actions)
        rows = np.arange(count)
        # one pass of the online network over both observations
        q = self.online(np.concatenate([observations, after]))
        value = self.target(after)[rows, q[count:].argmax(1)]
        goals = rewards + discounts * value
        within = goals if limits is None else goals.clip(*(limit.numpy() for limit in limits))
        error = q[rows, actions] - within
        gradient = np.zeros_like(q[:count])
        gradient[rows, actions] = 2 / count * error
        self.online.backward(gradient)

        if not adam:
            adam |= {"step": torch.zeros(()), "exp_avg": torch.zeros(self._weights.shape)}
            adam["exp_avg_sq"] = adam["exp_avg"].clone()
        adam["step"] += 1
        mean, square = adam["exp_avg"].numpy(), adam["exp_avg_sq"].numpy()
        descend(self._weights, self._gradient, mean, square, float(adam["step"]), rate, max_norm)
        if tau:
            approach(self._target_weights, self._weights, tau)
        return float(np.square(error).mean()), goals


class Compiled(Greedy):
    """A greedy policy whose network is an `EgoAttention` behind standardised inputs."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__(network)
        self._passes = Passes(network, flatten(network))

    def q(self, observation: np.ndarray) -> np.ndarray:
        """Q of every action, (actions,), for one observation."""
        return self._passes(observation[None])[0]


class Passes:
    """Passes through an `EgoAttention` behind standardised inputs, there and back.

    weights: of all its parameters, see `flatten`.
    """

    def __init__(self, module: nn.Module, weights: Tensor) -> None:
        assert isinstance(module, Standardised) and type(module.network) is EgoAttention
        assert weights.grad is not None
        announce()
        network = module.network
        modules = dict(network.named_children()) | dict(network.decision.named_children())
        parts = [[part for part in modules[name].modules() if isinstance(part, nn.Linear)] for name in PARTS]
        self._starts = np.array([0, *accumulate(map(len, parts))])
        self._layers = np.array(
            [
                (
                    layer.in_features,
                    layer.out_features,
                    layer is not part[-1] or number in (EGO, OTHERS, BASE),
                    layer.weight.storage_offset(),
                    -1 if layer.bias is None else layer.bias.storage_offset(),
                )
                for number, part in enumerate(parts)
                for layer in part
            ]
        )
        self._own = tuple(
            part.numpy() for part in (weights.detach(), weights.grad, module.mean, module.deviation)
        )
        self._kept: dict[int, Pass] = {}  # by the number of observations
        self._last: Pass

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Q-values (n, actions) of observations (n, vehicles, features) as they are, not standardised.

        Raises ValueError for other shapes, which compiled code would not notice.
        """
        n, wanted = len(observations), self._own[2].shape
        if observations.shape[1:] != wanted:
            raise ValueError(f"Expected observations (n, {wanted[0]}, {wanted[1]}), got {observations.shape}")
        if n not in self._kept:
            self._kept[n] = self._new(n)
        self._last = self._kept[n]
        # a copy, since Numba compiles once more for arrays that cannot be written to, or lie otherwise
        return np.asarray(forward(np.array(observations, self._own[0].dtype, order="C"), self._last))

    def backward(self, gradient: np.ndarray) -> None:
        """Write the gradients of all weights, from that of the first Q-values of the last call, (n, actions)."""
        backward(gradient, self._last)

    def _new(self, n: int) -> Pass:
        (vehicles, features), width = self._own[2].shape, self._layers[0, WIDTH]
        rows = np.full(len(self._layers), n)
        rows[self._starts[OTHERS] : self._starts[OTHERS + 1]] *= vehicles - 1
        sizes = np.cumsum(rows * self._layers[:, WIDTH])
        layers = np.column_stack([self._layers, rows, [0, *sizes[:-1]]])
        shapes = (
            (sizes[-1],),
            (n, features),
            (n * (vehicles - 1), features),
            (n, HEADS * width),
            (n, width),
            (n, vehicles, width),
            (n, HEADS, vehicles),
        )
        empty = [np.empty(shape, self._own[0].dtype) for shape in shapes]
        arrays: list[np.ndarray] = [*self._own, layers, self._starts, *empty]
        return Pass(*arrays)
