"""Matrices that are used again are as good as new."""

from __future__ import annotations

import numpy as np

from sumo_env.cars import Cars


def test_cleared_cars_are_as_new_ones() -> None:
    new, used = Cars(4), Cars(4)
    x = used.x
    for matrix in (used.floats, used.integers, used.flags):
        matrix.fill(1)
    used.clear()
    x[2] = new.x[2] = 7.0  # rows stay views of the matrices
    np.testing.assert_array_equal(used.floats, new.floats)
    np.testing.assert_array_equal(used.integers, new.integers)
    np.testing.assert_array_equal(used.flags, new.flags)
    assert len(used) == 4
