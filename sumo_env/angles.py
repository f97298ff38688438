"""Angles between -pi and pi."""

from __future__ import annotations

import math

from sumo_env.compiled import borrowing


@borrowing
def wrapped(angle: float, half: float = math.pi) -> float:
    """The angle [rad] less whole turns: from -pi to pi, or from -`half` to `half` where a turn is 2 `half`.

    The same bits as ``(angle + half) % (2 * half) - half``, but the remainder, which takes long, is worked out only
    where it is needed.
    """
    angle += half
    if not 0.0 <= angle < 2.0 * half:
        angle %= 2.0 * half
    return angle - half
