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
        for i in range(len(bias_gradient)):
            value = delta[row, i] if output[row, i] > 0 or not relu else 0
            delta[row, i] = value
            bias_gradient[i] += value


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
