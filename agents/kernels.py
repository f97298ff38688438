"""The attention network and its gradient, written out and compiled with Numba: the mathematics of `agents.models`.

The last bits differ from torch's, because sums are taken in another order. As torch's, they depend on the number of
threads (of scipy's BLAS, which makes the products; `dqn.train` sets one). All kernels are in this file: Numba compiles
again when the file of a function has changed.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

try:
    import numba
    import scipy.linalg.cython_blas  # noqa: F401  (numba loads it at the first product, when threads are set)
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(
        f"the learner is compiled, with numba and scipy, and {error.name} is not installed: pip install numba scipy, "
        "or set by_hand=false",
        name=error.name,
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


# Parts of the network, each of some linear layers, and their names in `EgoAttention`. Numbers of this type are no
# literals, for each of which Numba would compile `through` and `back` once more.
EGO, OTHERS, QUERY, OUTPUT, BASE, VALUE, ADVANTAGE = map(np.int64, range(7))
PARTS = "ego", "others", "query", "output", "base", "value", "advantage"
INPUTS, WIDTH, IS_RECTIFIED, WEIGHTS, BIASES, ROWS, VALUES = range(7)  # columns of `Pass.layers`


class Pass(NamedTuple):
    """A network, and what its pass over n observations leaves for the way back."""

    weights: np.ndarray  # of the whole network, in torch's memory
    gradient: np.ndarray  # likewise
    mean: np.ndarray  # of the inputs, (vehicles, features)
    deviation: np.ndarray  # likewise
    # a row each: inputs, outputs, whether a ReLU follows, where its weights and biases (-1: none) begin in `weights`;
    # and how many rows it gives, which begin in `values`
    layers: np.ndarray
    starts: np.ndarray  # the first layer of each part, and the number of layers
    values: np.ndarray
    ego: np.ndarray  # what the part ego reads, (rows, width)
    others: np.ndarray  # likewise the part others
    seen: np.ndarray  # likewise the part output
    both: np.ndarray  # likewise the part base
    vehicles: np.ndarray  # their codes, (n, vehicles, width)
    attention: np.ndarray  # (n, heads, vehicles)


@compiled
def forward(observations: np.ndarray, net: Pass) -> np.ndarray:
    """Q-values of observations, see `EgoAttention`."""
    n = len(observations)
    present = standardise(observations, net)
    ego = through(net.ego, EGO, net)
    others = through(net.others, OTHERS, net)
    for i in range(n):
        for j in range(net.vehicles.shape[1]):
            for k in range(ego.shape[1]):
                net.vehicles[i, j, k] = (
                    ego[i, k] if j == 0 else others[i * (net.vehicles.shape[1] - 1) + j - 1, k]
                )
    attend(through(ego, QUERY, net), present, net)
    answer = through(net.seen, OUTPUT, net)
    for i in range(n):
        for k in range(ego.shape[1]):
            net.both[i, k] = (answer[i, k] + ego[i, k]) / 2
    base = through(net.both, BASE, net)
    value = through(base, VALUE, net)
    advantage = through(base, ADVANTAGE, net)
    q = np.empty_like(advantage)
    for i in range(n):
        mean = advantage[i].mean()
        for action in range(q.shape[1]):
            q[i, action] = value[i, 0] + advantage[i, action] - mean
    return q


@compiled
def backward(gradient: np.ndarray, net: Pass) -> None:
    """Write the gradients of all weights from that of the Q-values."""
    n, actions = gradient.shape
    of_value, of_advantage = np.empty((n, 1), gradient.dtype), np.empty_like(gradient)
    for i in range(n):
        of_value[i, 0] = gradient[i].sum()
        for action in range(actions):
            of_advantage[i, action] = gradient[i, action] - of_value[i, 0] / actions
    base, ego = output(BASE, net), output(EGO, net)
    of_base = back(of_value, base, VALUE, net)
    add(back(of_advantage, base, ADVANTAGE, net), of_base)
    of_ego = back(of_base, net.both, BASE, net)
    for i in range(n):
        for k in range(of_ego.shape[1]):
            of_ego[i, k] /= 2
    of_seen = back(of_ego, net.seen, OUTPUT, net)
    of_query, of_others = attend_back(of_seen, output(QUERY, net), of_ego, net)
    add(back(of_query, ego, QUERY, net), of_ego)
    back(of_ego, net.ego, EGO, net)
    back(of_others, net.others, OTHERS, net)


@compiled
def standardise(observations: np.ndarray, net: Pass) -> np.ndarray:
    """Write the inputs of the parts ego and others; returns which vehicles are there, (n, vehicles)."""
    n, vehicles, features = observations.shape
    present = np.zeros((n, vehicles), np.bool_)
    for i in range(n):
        for j in range(vehicles):
            row = net.ego[i] if j == 0 else net.others[i * (vehicles - 1) + j - 1]
            row[:] = 0
            if observations[i, j].any():
                for k in range(features):
                    row[k] = (observations[i, j, k] - net.mean[j, k]) / net.deviation[j, k]
            present[i, j] = j == 0 or row.any()
    return present


@compiled
def weight(layer: int, vector: np.ndarray, net: Pass) -> np.ndarray:
    """The weights of a layer, (outputs, inputs), in such a vector of all weights."""
    rows, columns, start = net.layers[layer, WIDTH], net.layers[layer, INPUTS], net.layers[layer, WEIGHTS]
    return vector[start : start + rows * columns].reshape((rows, columns))


@compiled
def values(layer: int, net: Pass) -> np.ndarray:
    """The outputs of a layer, (rows, width)."""
    rows, columns, start = net.layers[layer, ROWS], net.layers[layer, WIDTH], net.layers[layer, VALUES]
    return net.values[start : start + rows * columns].reshape((rows, columns))


@compiled
def output(part: int, net: Pass) -> np.ndarray:
    """The outputs of a part, (rows, width)."""
    return values(net.starts[part + 1] - 1, net)


@compiled
def through(x: np.ndarray, part: int, net: Pass) -> np.ndarray:
    """The outputs of a part that reads `x`."""
    zero = x.dtype.type(0)
    for layer in range(net.starts[part], net.starts[part + 1]):
        y, biases = values(layer, net), net.layers[layer, BIASES]
        np.dot(x, weight(layer, net.weights, net).T, y)
        for i in range(len(y)):
            for j in range(y.shape[1]):
                if biases >= 0:
                    y[i, j] += net.weights[biases + j]
                if net.layers[layer, IS_RECTIFIED]:
                    y[i, j] = max(y[i, j], zero)
        x = y
    return x


@compiled
def back(gradient: np.ndarray, x: np.ndarray, part: int, net: Pass) -> np.ndarray:
    """Write the gradients of a part that reads `x`, from that of its outputs, which is changed; returns that of `x`."""
    n = len(gradient)
    for layer in range(net.starts[part + 1] - 1, net.starts[part] - 1, -1):
        if net.layers[layer, IS_RECTIFIED]:
            y = values(layer, net)
            for i in range(n):
                for j in range(y.shape[1]):
                    if y[i, j] <= 0:
                        gradient[i, j] = 0
        biases = net.layers[layer, BIASES]
        if biases >= 0:
            own = net.gradient[biases : biases + gradient.shape[1]]
            own[:] = 0
            for i in range(n):
                for j in range(len(own)):
                    own[j] += gradient[i, j]
        before = x if layer == net.starts[part] else values(layer - 1, net)
        np.dot(gradient.T, before[:n], weight(layer, net.gradient, net))
        gradient = np.dot(gradient, weight(layer, net.weights, net))
    return gradient


@compiled
def attend(query: np.ndarray, present: np.ndarray, net: Pass) -> None:
    """Write the weights of the vehicles, and what the heads see: their sum."""
    n, heads, vehicles = net.attention.shape
    width = net.vehicles.shape[2]
    root, zero = query.dtype.type(math.sqrt(width)), query.dtype.type(0)
    for i in range(n):
        for head in range(heads):
            first = head * width
            weights = net.attention[i, head]
            for j in range(vehicles):
                score = zero
                for k in range(width):
                    score += query[i, first + k] * net.vehicles[i, j, k]
                weights[j] = score / root if present[i, j] else -np.inf
            top, total = weights.max(), zero
            for j in range(vehicles):
                weights[j] = np.exp(weights[j] - top)
                total += weights[j]
            net.seen[i, first : first + width] = 0
            for j in range(vehicles):
                weights[j] /= total
                for k in range(width):
                    net.seen[i, first + k] += weights[j] * net.vehicles[i, j, k]


@compiled
def add(x: np.ndarray, to: np.ndarray) -> None:
    """Add an array of two dimensions to another one."""
    for i in range(x.shape[0]):
        for k in range(x.shape[1]):
            to[i, k] += x[i, k]


@compiled
def attend_back(
    of_seen: np.ndarray, query: np.ndarray, of_ego: np.ndarray, net: Pass
) -> tuple[np.ndarray, np.ndarray]:
    """The gradients of the query, (n, heads x width), and of the others' codes; that of the ego's is added to one."""
    n, (_, heads, vehicles), width = len(of_seen), net.attention.shape, net.vehicles.shape[2]
    root, zero = query.dtype.type(math.sqrt(width)), query.dtype.type(0)
    of_query, of_others = np.zeros_like(of_seen), np.zeros((n * (vehicles - 1), width), of_seen.dtype)
    change = np.empty(vehicles, of_seen.dtype)
    for i in range(n):
        for head in range(heads):
            first, weights = head * width, net.attention[i, head]
            total = zero
            for j in range(vehicles):
                of_weight = zero
                for k in range(width):
                    of_weight += of_seen[i, first + k] * net.vehicles[i, j, k]
                change[j] = weights[j] * of_weight
                total += change[j]
            for j in range(vehicles):
                of_score = (change[j] - weights[j] * total) / root
                own = of_ego[i] if j == 0 else of_others[i * (vehicles - 1) + j - 1]
                for k in range(width):
                    of_query[i, first + k] += of_score * net.vehicles[i, j, k]
                    own[k] += weights[j] * of_seen[i, first + k] + of_score * query[i, first + k]
    return of_query, of_others


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
    """One step of Adam with torch's betas and epsilon, after the gradient was cut to a norm.

    Args:
        weights, gradient: of a whole network, (n,). mean, square: Adam's moments. step: from 1.
    """
    number, total = weights.dtype.type, 0.0
    for k in range(len(gradient)):
        total += gradient[k] * gradient[k]
    cut = number(min(1.0, max_norm / (math.sqrt(total) + 1e-6)))
    pace, root, epsilon = number(rate / (1 - 0.9**step)), number(math.sqrt(1 - 0.999**step)), number(1e-8)
    for k in range(len(weights)):
        mean[k] += number(0.1) * (cut * gradient[k] - mean[k])
        square[k] += number(0.001) * ((cut * gradient[k]) ** 2 - square[k])
        weights[k] -= pace * mean[k] / (np.sqrt(square[k]) / root + epsilon)


@compiled
def approach(target: np.ndarray, weights: np.ndarray, tau: float) -> None:
    """Move weights towards others by a share of the way."""
    for k in range(len(target)):
        target[k] += target.dtype.type(tau) * (weights[k] - target[k])
