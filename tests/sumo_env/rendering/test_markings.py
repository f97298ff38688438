"""What is painted of a road."""

from __future__ import annotations

import numpy as np

from sumo_env.rendering.markings import markings
from sumo_env.tasks import TASKS


def test_opposite_lanes_are_divided_by_one_dashed_line() -> None:
    divided = {"highway": 3, "two-way": 1, "intersection": 2}
    for task, lines in divided.items():
        road = TASKS[task].road({**TASKS[task].defaults})
        dashes = np.array([dash.mean(axis=0) for dash in markings(road).dashes])
        straight = {(round(float(x), 1), "x") for x in dashes[:, 0] if np.isclose(dashes[:, 0], x).sum() > 10}
        straight |= {
            (round(float(y), 1), "y") for y in dashes[:, 1] if np.isclose(dashes[:, 1], y).sum() > 10
        }
        assert len(straight) == lines
