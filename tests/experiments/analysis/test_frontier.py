"""The frontier of drivers of fixed rules, and an agent's distance to it."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.spatial import ConvexHull

from experiments.analysis.frontier import lower_hull, to_frontier


@pytest.mark.parametrize("seed", range(20))
def test_the_hull_is_the_lower_part_of_scipys(seed: int) -> None:
    points = np.random.default_rng(seed).random((9, 2))
    found = lower_hull(pd.DataFrame(points, columns=["progress", "crashed"]))
    ends = points[:, 0].min(), points[:, 0].max()
    line = np.interp(points[:, 0], found["progress"], found["crashed"])
    assert (found["progress"].iloc[0], found["progress"].iloc[-1]) == ends
    assert (points[:, 1] >= line - 1e-12).all()
    corners = {tuple(points[k]) for k in ConvexHull(points).vertices}
    assert set(found.itertuples(index=False, name=None)) <= corners


def episodes(policy: str, kind: str, arm: str | None, progress: float, crashes: list[bool]) -> pd.DataFrame:
    place = {"backend": "sumo", "task": "u-turn", "level": 1, "level_name": "3", "tested_on": "sumo"}
    own = {"cell": policy, "policy": policy, "kind": kind, "arm": arm, "traffic": "risky", "seconds": 10.0}
    return pd.DataFrame({**place, **own, "progress": progress, "crashed": np.array(crashes, float)})


def test_the_distance_is_the_crash_rate_above_the_line_between_two_drivers() -> None:
    rules = [
        episodes("slower", "baseline", None, 4.0, [False] * 4),
        episodes("careful-4", "baseline", None, 8.0, [True] * 4),
        episodes("idle", "baseline", None, 6.0, [True] * 4),  # above the line between the others
        episodes("planner", "baseline", None, 6.0, [False] * 4),  # of the user's own: no part of the frontier
    ]
    agents = [
        episodes("a", "agent", "control", 6.0, [True, True, True, False]),  # .75 where the line is at .5
        episodes("b", "agent", "control", 5.0, [True, False, False, False]),  # .25 at .25
        episodes("c", "agent", "control", 9.0, [True] * 4),  # faster than all drivers
    ]
    [found] = to_frontier(pd.concat(rules + agents)).to_dict("records")
    half = stats.t.ppf(0.975, 1) * np.std([0.25, 0.0], ddof=1) / np.sqrt(2)
    assert (found["arm"], found["traffic"], found["agents"], found["inside"]) == ("control", "risky", 3, 2)
    assert found["estimate"] == pytest.approx(0.125)
    assert (found["low"], found["high"]) == pytest.approx((0.125 - half, 0.125 + half))


def test_without_drivers_there_is_no_distance() -> None:
    assert to_frontier(episodes("a", "agent", "control", 6.0, [True, False])).empty
