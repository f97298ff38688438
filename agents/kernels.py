"""Element-wise parts of the learner, each one compiled pass over its arrays: numpy would make three to ten.

No kernel may call another one: numba would not notice that the other has changed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile at the first call, and keep the machine code where a directory can be written."""
    try:
        return cast(Function, njit(cache=True)(function))
    except RuntimeError as error:
        if "no locator available" not in str(error):
            raise
        return cast(Function, njit(function))


@compiled
def add_bias(output: np.ndarray, bias: np.ndarray, relu: bool) -> None:
    """output (rows, n) += bias (n,), then ReLU where the layer has one."""
    for row in range(len(output)):
        for i in range(len(bias)):
            value = output[row, i] + bias[i]
            output[row, i] = value if value > 0 or not relu else 0


@compiled
def back_through_bias(delta: np.ndarray, output: np.ndarray, relu: bool, bias_gradient: np.ndarray) -> None:
    """Set delta (rows, n) to 0 where the ReLU's output (rows, n) is not positive, and sum it over the rows."""
    bias_gradient[:] = 0
    for row in range(len(delta)):
        if relu:  # asked for each row and not each number: the loops are vectorised then
            for i in range(len(bias_gradient)):
                value = delta[row, i] if output[row, i] > 0 else 0
                delta[row, i] = value
                bias_gradient[i] += value
        else:
            for i in range(len(bias_gradient)):
                bias_gradient[i] += delta[row, i]


@compiled
def join_streams(value: np.ndarray, advantage: np.ndarray, centred: bool, q: np.ndarray) -> None:
    """Q (rows, actions) = V + A, less the mean of A if it is centred; V (fewer or equal rows, 1) or else 0."""
    for row in range(len(q)):
        offset = value[row, 0] if row < len(value) else 0
        if centred:
            offset -= advantage[row].mean()
        for action in range(q.shape[1]):
            q[row, action] = advantage[row, action] + offset


@compiled
def split_gradient(
    q_gradient: np.ndarray, centred: bool, value_gradient: np.ndarray, advantage_gradient: np.ndarray
) -> None:
    """The way back through `join_streams`; q_gradient (rows, actions)."""
    for row in range(len(q_gradient)):
        total = q_gradient[row].sum()
        value_gradient[row, 0] = total
        mean = total / q_gradient.shape[1] if centred else 0
        for action in range(q_gradient.shape[1]):
            advantage_gradient[row, action] = q_gradient[row, action] - mean


@njit(cache=True, error_model="numpy")
def adam(
    weights: np.ndarray,
    gradient: np.ndarray,
    mean: np.ndarray,
    square: np.ndarray,
    clamp: np.float32,
    rate: np.float32,
    keep_mean: np.float32,
    keep_square: np.float32,
    correction: np.float32,
    epsilon: np.float32,
) -> None:
    """A step of Adam (Kingma and Ba 2015) with every entry of the gradient clamped to +-clamp; all (parameters,).

    rate: learning rate over 1 - beta1^t; correction: sqrt(1 - beta2^t), at the t-th step.
    keep_mean and keep_square: beta1 and beta2.
    """
    one = np.float32(1)
    tiny = np.float32(1.1754944e-38)  # smaller numbers are denormal: moments of units that died, and slow
    for i in range(len(weights)):
        g = min(max(gradient[i], -clamp), clamp)
        m = keep_mean * mean[i] + (one - keep_mean) * g
        v = keep_square * square[i] + (one - keep_square) * g * g
        m = m if abs(m) >= tiny else np.float32(0)
        v = v if v >= tiny else np.float32(0)
        mean[i] = m
        square[i] = v
        weights[i] -= rate * m / (np.sqrt(v) / correction + epsilon)
