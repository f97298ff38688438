"""The report's tables, from small frames whose numbers one can compute in the head."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pandas as pd

from experiments.reporting import tables

SETTING = {"backend": "sumo", "task": "u-turn", "level": 1, "level_name": "3"}
NAN = float("nan")


def analysis(**frames: Any) -> Any:
    """As much of an analysis as a table reads."""
    return SimpleNamespace(**frames)


def test_the_frontier_table_has_a_row_an_arm_and_says_how_many_agents_are_compared() -> None:
    columns = ["arm", "traffic", "agents", "inside", "estimate", "low", "high"]
    found = pd.DataFrame(
        [
            ["control", "risky", 5, 4, 0.125, 0.05, 0.2],
            ["control", "regular", 5, 1, -0.03, NAN, NAN],  # one agent has no interval
            ["treatment", "risky", 5, 0, NAN, NAN, NAN],  # faster than all drivers
        ],
        columns=columns,
    ).assign(**SETTING)
    elsewhere = found.assign(backend="replica", estimate=0.9)
    table = tables.frontier(analysis(frontier=pd.concat([found, elsewhere])), "sumo")
    shown = ["risky traffic", "agents, risky", "regular traffic", "agents, regular"]
    assert table.columns.tolist() == ["setting", "arm", *shown]
    control, treatment = table.fillna("").to_numpy().tolist()
    assert control == ["u-turn 3", "control", "+12.5 [+5.0, +20.0]", "4 of 5", "−3.0", "1 of 5"]
    assert treatment == ["u-turn 3", "treatment", "–", "0 of 5", "", ""]


def test_the_unseen_table_sets_each_traffic_beside_that_of_the_training() -> None:
    rates = {"risky": (0.5, 0.25), "only-brake": (0.4, 0.4), "krauss": (0.3, 0.1)}
    rows = [
        {**SETTING, "arm": arm, "policy": "dqn", "traffic": traffic, "crashed": rate, "crashed se": 0.02}
        for traffic, both in rates.items()
        for arm, rate in zip(("control", "treatment"), both, strict=True)
    ]
    careful = {**rows[0], "arm": "", "policy": "careful", "crashed": 0.0}  # not of an agent
    regular = {**rows[0], "traffic": "regular", "crashed": 0.01}  # not risky
    other_task = {**rows[0], "task": "highway", "level_name": "50"}  # nothing unseen was tested there
    there = pd.DataFrame([careful, regular, other_task, *rows]).assign(crash_closing_speed=7.25)
    table = tables.unseen(analysis(policies=there), "sumo").to_numpy().tolist()
    assert table == [
        ["u-turn 3", "risky", "50.0 % ± 2.0, 7.2 m/s", "25.0 % ± 2.0, 7.2 m/s"],
        ["u-turn 3", "only-brake", "40.0 % ± 2.0, 7.2 m/s", "40.0 % ± 2.0, 7.2 m/s"],
        ["u-turn 3", "krauss", "30.0 % ± 2.0, 7.2 m/s", "10.0 % ± 2.0, 7.2 m/s"],
    ]
