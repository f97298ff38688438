"""What the report's figures draw, as numbers."""

from __future__ import annotations

from typing import Any

import pandas as pd
import pytest
from matplotlib.axes import Axes

from experiments.reporting import figures


def test_bars_over_the_traffic_levels_are_95_percent_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[float, float]] = []

    def errorbar(self: Axes, x: Any, y: Any, half: Any, **style: Any) -> None:
        drawn.extend(zip(y, half, strict=True))

    monkeypatch.setattr(Axes, "errorbar", errorbar)
    means = {("control", "regular"): 0.5, ("control", "risky"): 0.3, ("treatment", "regular"): 0.4}
    place = {"task": "u-turn", "level": 1, "level_name": "3", "policy": "dqn"}
    figures.against_traffic(
        pd.DataFrame(
            [
                {**place, "arm": arm, "traffic": traffic, "n": 5, "crashed": mean, "crashed se": 0.1}
                for (arm, traffic), mean in means.items()
            ]
        ),
        "sumo",
    )
    assert sorted(mean for mean, _ in drawn) == [0.3, 0.4, 0.5]
    # t with 4 degrees of freedom
    assert [half for _, half in drawn] == pytest.approx([0.2776] * 3, abs=1e-4)


def test_the_line_under_the_policies_is_the_frontier_of_the_analysis(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[list[tuple[float, float]]] = []

    def plot(self: Axes, x: Any, y: Any, *_: Any, **style: Any) -> None:
        if "lw" in style:
            lines.append(list(zip(x, y, strict=True)))

    monkeypatch.setattr(Axes, "plot", plot)
    places = {
        "slower": (5.0, 0.1),
        "idle": (9.0, 0.3),
        "faster": (12.0, 0.5),
        "careful": (8.0, 0.35),  # above the line between the others
        "idm": (9.0, 0.2),  # below it, but not of the frontier, as a policy of the user's own
        "mine.py:Mine": (9.0, 0.0),
    }
    rows = [
        {"task": "u-turn", "traffic": "risky", "policy": policy, "arm": "", "progress": x, "crashed": y}
        for policy, (x, y) in places.items()
    ]
    figures.crashes_against_progress(pd.DataFrame(rows), "sumo")
    assert [line for line in lines if line] == [[(5.0, 0.1), (9.0, 0.3), (12.0, 0.5)]]


def test_the_hazard_is_the_share_of_the_drives_still_on_the_road_that_crashes() -> None:
    drives = pd.DataFrame(
        {"cell": "a", "crash_free_time": [0.0, 0.9, 2.0, 3.0, 3.0], "crashed": [1.0, 0.0, 1.0, 1.0, 0.0]}
    )
    other = pd.DataFrame({"cell": "b", "crash_free_time": [1.5], "crashed": [1.0]})
    found = figures.hazards(pd.concat([drives, other]))
    # five drives in the first second, three in the second, two in the third
    assert found.loc["a"].tolist() == pytest.approx([1 / 5, 1 / 3, 1 / 2])
    assert found.loc["b"].tolist() == pytest.approx([0.0, 1.0, float("nan")], nan_ok=True)
