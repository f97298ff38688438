"""Double DQN on the attention network, written out and compiled: the mathematics of `agents.dqn` and `agents.models`.

The last bits differ from torch's, because sums are taken in another order. As torch's, they depend on the number of
threads (`OMP_NUM_THREADS`).
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from itertools import accumulate
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from agents.models import EgoAttention, Standardised
from agents.replay import Batch

try:
    import numba
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        "by_hand=true is compiled with numba, which is not installed: pip install numba", name=error.name
    ) from None


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function at its first call. Sums may be taken in any order, so that they are vectorised."""
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"reassoc", "contract", "nsz"},
    }
    try:
        return numba.njit(cache=True, **options)(function)
    except RuntimeError as error:
        if "no locator available" not in str(error):  # no folder for machine code can be written to
            raise
        return numba.njit(**options)(function)


PARTS = "ego", "others", "query", "output", "base", "value", "advantage"


class Net(NamedTuple):
    """The linear layers of a network, part after part, as arrays in torch's memory.

    Attributes:
        weights, biases: of each layer, zeros for a layer without biases. weight_gradients, bias_gradients: to write to.
        starts: the number of the first layer of each of `PARTS`, and the number of layers.
        heads: of the attention. mean, deviation: of the inputs, (vehicles, features).
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    weight_gradients: tuple[np.ndarray, ...]
    bias_gradients: tuple[np.ndarray, ...]
    starts: tuple[int, ...]
    heads: int
    mean: np.ndarray
    deviation: np.ndarray


class Values(NamedTuple):
    """What a pass over n observations leaves for the way back.

    Attributes:
        outputs: of each layer, (rows, width). ego, others, seen, both: what the parts ego, others, output and base
            read, (rows, width). vehicles: their codes, (n, vehicles, width). attention: (n, heads, vehicles).
    """

    outputs: tuple[np.ndarray, ...]
    ego: np.ndarray
    others: np.ndarray
    seen: np.ndarray
    both: np.ndarray
    vehicles: np.ndarray
    attention: np.ndarray


class ByHand:
    """The updates of a double DQN whose networks are `EgoAttention` behind standardised inputs, on the CPU.

    online, target: the networks, whose weights lie in one vector each: weights, target_weights.
    """

    def __init__(self, online: nn.Module, target: nn.Module, weights: Tensor, target_weights: Tensor) -> None:
        self.online, self.target = Passes(online), Passes(target)
        assert weights.grad is not None
        self._gradient = weights.grad.numpy()
        self._weights, self._target_weights = weights.detach().numpy(), target_weights.detach().numpy()
        folder = forward.stats.cache_path
        if not (folder and [*Path(folder).glob("by_hand.forward-*.nbi")]):
            print(
                "agents: Numba compiles the network, once for this installation ...",
                file=sys.stderr,
                flush=True,
            )

    def update(
        self, batch: Batch, adam: dict[str, Tensor], gamma: float, max_norm: float, rate: float, tau: float
    ) -> float:
        """One update, see `DQN.update`; returns the loss. adam: its state as torch keeps it, empty in the beginning."""
        observations, actions, rewards, after, terminated = (part.numpy() for part in batch)
        count = len(actions)
        rows = np.arange(count)
        # one pass of the online network over both observations
        q = self.online(np.concatenate([observations, after]))
        value = self.target(after)[rows, q[count:].argmax(1)]
        error = q[rows, actions] - (rewards + gamma * (1 - terminated) * value)
        gradient = np.zeros_like(q[:count])
        gradient[rows, actions] = 2 / count * error
        self.online.backward(gradient)

        if not adam:
            zeros = np.zeros((2, len(self._weights)), np.float32)
            adam |= dict(
                zip(
                    ("step", "exp_avg", "exp_avg_sq"),
                    (torch.zeros(()), *map(torch.from_numpy, zeros)),
                    strict=True,
                )
            )
        adam["step"] += 1
        moments = adam["exp_avg"].numpy(), adam["exp_avg_sq"].numpy()
        descend(self._weights, self._gradient, *moments, float(adam["step"]), rate, max_norm)
        if tau:
            approach(self._target_weights, self._weights, tau)
        return float(np.square(error).mean())


class Passes:
    """Passes through an `EgoAttention` behind standardised inputs, there and back."""

    def __init__(self, module: nn.Module) -> None:
        assert isinstance(module, Standardised) and type(module.network) is EgoAttention
        network = module.network
        modules = dict(network.named_children()) | dict(network.decision.named_children())
        parts = [
            [layer for layer in modules[name].modules() if isinstance(layer, nn.Linear)] for name in PARTS
        ]
        layers = [layer for part in parts for layer in part]

        pairs = [
            (
                layer.weight,
                torch.zeros(layer.out_features, dtype=module.mean.dtype)
                if layer.bias is None
                else layer.bias,
            )
            for layer in layers
        ]
        weights, biases = (tuple(part.detach().numpy() for part in own) for own in zip(*pairs, strict=True))
        weight_gradients, bias_gradients = (
            tuple((torch.zeros_like(part) if part.grad is None else part.grad).numpy() for part in own)
            for own in zip(*pairs, strict=True)
        )
        self._net = Net(
            weights,
            biases,
            weight_gradients,
            bias_gradients,
            (0, *accumulate(map(len, parts))),
            network.heads,
            module.mean.numpy(),
            module.deviation.numpy(),
        )
        self._kept: dict[int, Values] = {}  # by the number of observations
        self._last: Values

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Q-values (n, actions) of observations (n, vehicles, features) as they are, not standardised."""
        n = len(observations)
        if n not in self._kept:
            self._kept[n] = self._new(n)
        self._last = self._kept[n]
        return np.asarray(forward(observations, self._net, self._last))

    def backward(self, gradient: np.ndarray) -> None:
        """Write the gradients of all weights, from that of the first Q-values of the last call, (n, actions)."""
        backward(gradient, self._net, self._last)

    def _new(self, n: int) -> Values:
        (vehicles, features), width = self._net.mean.shape, len(self._net.weights[0])
        rows = np.full(len(self._net.weights), n)
        rows[self._net.starts[1] : self._net.starts[2]] *= vehicles - 1

        def new(*shape: int) -> np.ndarray:
            return np.empty(shape, self._net.mean.dtype)

        return Values(
            tuple(new(count, len(weight)) for count, weight in zip(rows, self._net.weights, strict=True)),
            new(n, features),
            new(n * (vehicles - 1), features),
            new(n, self._net.heads * width),
            new(n, width),
            new(n, vehicles, width),
            new(n, self._net.heads, vehicles),
        )


@compiled
def forward(observations: np.ndarray, net: Net, values: Values) -> np.ndarray:
    """Q-values of observations, see `EgoAttention`."""
    starts, outputs, n = net.starts, values.outputs, len(observations)
    present = standardise(observations, net, values)
    ego = through(values.ego, starts[0], starts[1], False, net, outputs)
    others = through(values.others, starts[1], starts[2], False, net, outputs)
    values.vehicles[:, 0] = ego
    values.vehicles[:, 1:] = others.reshape((n, -1, ego.shape[1]))
    attend(through(ego, starts[2], starts[3], True, net, outputs), present, values)
    answer = through(values.seen, starts[3], starts[4], True, net, outputs)
    for i in range(n):
        for k in range(ego.shape[1]):
            values.both[i, k] = (answer[i, k] + ego[i, k]) / 2
    base = through(values.both, starts[4], starts[5], False, net, outputs)
    value = through(base, starts[5], starts[6], True, net, outputs)
    q = through(base, starts[6], starts[7], True, net, outputs).copy()
    for i in range(n):
        q[i] += value[i, 0] - q[i].mean()
    return q


@compiled
def backward(gradient: np.ndarray, net: Net, values: Values) -> None:
    """Write the gradients of all weights from that of the Q-values."""
    starts, outputs, n = net.starts, values.outputs, len(gradient)
    of_value, of_advantage = np.empty((n, 1), gradient.dtype), np.empty_like(gradient)
    for i in range(n):
        of_value[i, 0] = gradient[i].sum()
        of_advantage[i] = gradient[i] - gradient[i].mean()
    base, ego = outputs[starts[5] - 1], outputs[starts[1] - 1]
    of_base = back(of_value, base, starts[5], starts[6], True, net, outputs)
    of_base += back(of_advantage, base, starts[6], starts[7], True, net, outputs)
    of_ego = back(of_base, values.both, starts[4], starts[5], False, net, outputs)
    for i in range(n):
        for k in range(of_ego.shape[1]):
            of_ego[i, k] /= 2
    of_seen = back(of_ego, values.seen, starts[3], starts[4], True, net, outputs)
    of_query, of_vehicles = attend_back(of_seen, outputs[starts[3] - 1], values)
    of_ego += back(of_query, ego, starts[2], starts[3], True, net, outputs)
    of_ego += of_vehicles[:, 0]
    back(of_ego, values.ego, starts[0], starts[1], False, net, outputs)
    of_others = of_vehicles[:, 1:].copy().reshape((-1, of_ego.shape[1]))
    back(of_others, values.others, starts[1], starts[2], False, net, outputs)


@compiled
def standardise(observations: np.ndarray, net: Net, values: Values) -> np.ndarray:
    """Write the inputs of the parts ego and others; returns which vehicles are there, (n, vehicles)."""
    n, vehicles, features = observations.shape
    present = np.zeros((n, vehicles), np.bool_)
    for i in range(n):
        for j in range(vehicles):
            row = values.ego[i] if j == 0 else values.others[i * (vehicles - 1) + j - 1]
            row[:] = 0
            if observations[i, j].any():
                for k in range(features):
                    row[k] = (observations[i, j, k] - net.mean[j, k]) / net.deviation[j, k]
            present[i, j] = j == 0 or row.any()
    return present


@compiled
def through(
    x: np.ndarray, start: int, end: int, linear_end: bool, net: Net, outputs: tuple[np.ndarray, ...]
) -> np.ndarray:
    """The output of layers, each followed by a ReLU, or all but the last (`linear_end`)."""
    zero = x.dtype.type(0)
    for layer in range(start, end):
        y, bias = outputs[layer], net.biases[layer]
        np.dot(x, net.weights[layer].T, y)
        if linear_end and layer == end - 1:
            for i in range(y.shape[0]):
                for j in range(y.shape[1]):
                    y[i, j] += bias[j]
        else:
            for i in range(y.shape[0]):
                for j in range(y.shape[1]):
                    y[i, j] = max(y[i, j] + bias[j], zero)
        x = y
    return x


@compiled
def back(
    gradient: np.ndarray,
    x: np.ndarray,
    start: int,
    end: int,
    linear_end: bool,
    net: Net,
    outputs: tuple[np.ndarray, ...],
) -> np.ndarray:
    """Write the gradients of layers that read `x`, from that of their output, which is changed; returns that of `x`."""
    for layer in range(end - 1, start - 1, -1):
        y, bias_gradient = outputs[layer], net.bias_gradients[layer]
        before = x if layer == start else outputs[layer - 1]
        bias_gradient[:] = 0
        for i in range(gradient.shape[0]):
            for j in range(gradient.shape[1]):
                if y[i, j] <= 0 and not (linear_end and layer == end - 1):
                    gradient[i, j] = 0
                bias_gradient[j] += gradient[i, j]
        np.dot(gradient.T, before[: len(gradient)], net.weight_gradients[layer])
        gradient = np.dot(gradient, net.weights[layer])
    return gradient


@compiled
def attend(query: np.ndarray, present: np.ndarray, values: Values) -> None:
    """Write the weights of the vehicles, and what the heads see: their sum."""
    n, heads, vehicles = values.attention.shape
    width = values.vehicles.shape[2]
    root, zero = query.dtype.type(math.sqrt(width)), query.dtype.type(0)
    for i in range(n):
        for head in range(heads):
            first = head * width
            weights = values.attention[i, head]
            for j in range(vehicles):
                score = zero
                for k in range(width):
                    score += query[i, first + k] * values.vehicles[i, j, k]
                weights[j] = score / root if present[i, j] else -np.inf
            top, total = weights.max(), zero
            for j in range(vehicles):
                weights[j] = np.exp(weights[j] - top)
                total += weights[j]
            values.seen[i, first : first + width] = 0
            for j in range(vehicles):
                weights[j] /= total
                for k in range(width):
                    values.seen[i, first + k] += weights[j] * values.vehicles[i, j, k]


@compiled
def attend_back(of_seen: np.ndarray, query: np.ndarray, values: Values) -> tuple[np.ndarray, np.ndarray]:
    """The gradients of the query, (n, heads x width), and of the vehicles' codes, (n, vehicles, width)."""
    n, (_, heads, vehicles), width = len(of_seen), values.attention.shape, values.vehicles.shape[2]
    root, zero = query.dtype.type(math.sqrt(width)), query.dtype.type(0)
    of_query, of_vehicles = np.zeros_like(of_seen), np.zeros((n, vehicles, width), of_seen.dtype)
    change = np.empty(vehicles, of_seen.dtype)
    for i in range(n):
        for head in range(heads):
            first, weights = head * width, values.attention[i, head]
            total = zero
            for j in range(vehicles):
                of_weight = zero
                for k in range(width):
                    of_weight += of_seen[i, first + k] * values.vehicles[i, j, k]
                change[j] = weights[j] * of_weight
                total += change[j]
            for j in range(vehicles):
                of_score = (change[j] - weights[j] * total) / root
                for k in range(width):
                    of_query[i, first + k] += of_score * values.vehicles[i, j, k]
                    of_vehicles[i, j, k] += (
                        weights[j] * of_seen[i, first + k] + of_score * query[i, first + k]
                    )
    return of_query, of_vehicles


@compiled
def descend(
    weights: np.ndarray,
    gradient: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    step: float,
    rate: float,
    max_norm: float,
) -> None:
    """One step of Adam as torch's (its betas and epsilon), after the gradient was cut to a norm.

    Args:
        weights, gradient: all of a network, (n,). mean, square: Adam's moments. step: from 1.
    """
    number = weights.dtype.type
    total = number(0)
    for k in range(len(gradient)):
        total += gradient[k] * gradient[k]
    cut = number(min(1.0, max_norm / (math.sqrt(total) + 1e-6)))
    rate_now, root = number(rate / (1.0 - 0.9**step)), number(math.sqrt(1.0 - 0.999**step))
    beta, rest, beta_square, rest_square, epsilon = (
        number(0.9),
        number(0.1),
        number(0.999),
        number(0.001),
        number(1e-8),
    )
    for k in range(len(weights)):
        g = cut * gradient[k]
        mean[k] = beta * mean[k] + rest * g
        square[k] = beta_square * square[k] + rest_square * g * g
        weights[k] -= rate_now * mean[k] / (np.sqrt(square[k]) / root + epsilon)


@compiled
def approach(target: np.ndarray, weights: np.ndarray, tau: float) -> None:
    """Move weights towards others by a share of the way."""
    share = target.dtype.type(tau)
    for k in range(len(target)):
        target[k] += share * (weights[k] - target[k])
