"""What the report's figures draw, as numbers."""

from __future__ import annotations

from typing import Any

import pytest
from matplotlib.axes import Axes

from experiments.reporting import figures


def test_bars_over_the_traffic_levels_are_95_percent_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[list[float], list[float]]] = []

    def errorbar(self: Axes, x: Any, y: Any, half: Any, **style: Any) -> None:
        drawn.append((list(y), list(half)))

    monkeypatch.setattr(Axes, "errorbar", errorbar)
    means = {("control", "regular"): 5.0, ("control", "risky"): 3.0, ("treatment", "regular"): 4.0}
    figures.against_traffic(
        [
            {
                "backend": "sumo", "task": "u-turn", "level": 1, "level_name": "3", "arm": arm, "policy": "dqn",
                "traffic": traffic, "n": 5, "mean": {"return": mean, "crashed": 0.5},
                "se": {"return": 1.0, "crashed": 0.1},
            }
            for (arm, traffic), mean in means.items()
        ],
        "u-turn",
    )  # fmt: skip
    returns = [
        (mean, half) for means, halves in drawn for mean, half in zip(means, halves, strict=True) if mean > 1
    ]
    assert sorted(mean for mean, _ in returns) == [3.0, 4.0, 5.0]
    assert [half for _, half in returns] == pytest.approx(
        [2.776] * 3, abs=1e-3
    )  # t with 4 degrees of freedom
