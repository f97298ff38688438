"""Angles that are wrapped without a remainder, against the remainder."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sumo_env.angles import wrapped


@pytest.mark.parametrize("half", [math.pi, 20.0 * math.pi])
def test_wrapping_has_the_bits_of_the_remainder(half: float) -> None:
    rng = np.random.default_rng(0)
    edges = [-3.0 * half, -half, -0.0, 0.0, half, 3.0 * half]
    edges += [np.nextafter(edge, side) for edge in edges for side in (-math.inf, math.inf)]
    angles = np.concatenate((edges, rng.uniform(-5.0 * half, 5.0 * half, 1000)))
    for angle in angles.tolist():
        assert np.float64(wrapped(angle, half)).tobytes() == np.float64((angle + half) % (2 * half) - half).tobytes()
        assert -half <= wrapped(angle, half) <= half
    assert math.isnan(wrapped(math.nan, half))
