"""The tables that a report leads with, from small frames whose numbers one can compute in the head."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pandas as pd

from experiments.reporting import by_task


def analysis(**frames: Any) -> Any:
    """As much of an analysis as a table reads."""
    return SimpleNamespace(**frames)


def rows_by_task(*rows: tuple[Any, ...]) -> pd.DataFrame:
    """scope, simulator, traffic, outcome, control, treated, low and high of the difference."""
    columns = ["scope", "tested_on", "traffic", "outcome", "mean_against", "mean_arm", "low", "high"]
    found = pd.DataFrame(rows, columns=columns).assign(
        backend="sumo", arm="treatment", against="control", status="ok"
    )
    return found.assign(estimate=found["mean_arm"] - found["mean_against"])


TASKS = rows_by_task(
    ("u-turn", "sumo", "regular", "crashed", 0.02, 0.02, -0.01, 0.01),
    ("u-turn", "sumo", "risky", "crashed", 0.74, 0.13, -0.64, -0.57),
    ("u-turn", "sumo", "risky", "crashes_per_100_km", 632.3, 136.2, -535.1, -457.2),
    ("u-turn", "sumo", "only-parameters", "crashed", 0.017, 0.008, -0.016, -0.002),
    ("u-turn", "replica", "risky", "crashed", 0.65, 0.09, -0.60, -0.52),
    ("two-way", "sumo", "regular", "crashed", 0.2, 0.57, 0.32, 0.42),
    ("two-way", "sumo", "risky", "crashed", 0.8, 0.71, -0.13, -0.05),
    ("all tasks", "sumo", "risky", "crashed", 0.77, 0.42, -0.38, -0.31),
    ("without u-turn", "sumo", "risky", "crashed", 0.8, 0.71, -0.13, -0.05),
    ("without two-way", "sumo", "risky", "crashed", 0.74, 0.13, -0.64, -0.57),
)  # fmt: skip


def test_the_table_of_tasks_has_a_line_a_task_and_traffic() -> None:
    table = by_task.by_task(analysis(by_task=TASKS), "sumo")
    assert table.columns.tolist() == ["task", "traffic", *by_task.TITLES.values()]
    assert table.iloc[:, :4].to_numpy().tolist() == [
        ["u-turn", "risky", "74.0 → 13.0\n−61.0 [−64.0, −57.0]", "632 → 136\n−496 [−535, −457]"],
        ["u-turn", "regular", "2.0 → 2.0\n0.0 [−1.0, +1.0]", "–"],
        ["two-way", "risky", "80.0 → 71.0\n−9.0 [−13.0, −5.0]", "–"],
        ["two-way", "regular", "20.0 → 57.0\n+37.0 [+32.0, +42.0]", "–"],
    ]
    away = by_task.by_task(analysis(by_task=TASKS), "sumo", away=True)
    assert away.iloc[:, :3].to_numpy().tolist()[:2] == [
        ["u-turn", "risky drivers, no events", "1.7 → 0.8\n−0.9 [−1.6, −0.2]"],
        ["u-turn", "risky, replica", "65.0 → 9.0\n−56.0 [−60.0, −52.0]"],
    ]


def test_a_mean_over_tasks_has_every_one_left_out_below_it() -> None:
    table = by_task.means_of_tasks(analysis(by_task=TASKS), "sumo")
    assert table.columns.tolist() == ["mean", "risky traffic [points]"]
    assert table["mean"].tolist() == ["all tasks", "without two-way", "without u-turn"]
    one_task = TASKS[TASKS["scope"].isin(["u-turn", "all tasks"])]
    assert by_task.means_of_tasks(analysis(by_task=one_task), "sumo").empty


def test_tasks_are_on_the_side_that_the_plan_or_their_interval_says() -> None:
    """Of the primary outcome at home by the plan, whatever the interval says; of all else by the interval."""
    verdicts = [("u-turn", "risky", "less"), ("two-way", "risky", "open"), ("two-way", "regular", "more")]
    primary = pd.DataFrame(verdicts, columns=["scope", "term", "verdict"])
    found = analysis(by_task=TASKS, primary=primary.assign(backend="sumo", outcome="crashed"))
    assert by_task.sides(found, "sumo", "crashed", ("sumo", "risky")) == {
        "less": ["u-turn"],
        "more": [],
        "open": ["two-way"],
    }
    assert by_task.sides(found, "sumo", "crashed", ("sumo", "regular"))["more"] == ["two-way"]
    per_distance = by_task.sides(found, "sumo", "crashes_per_100_km", ("sumo", "risky"))
    assert per_distance == {"less": ["u-turn"], "more": [], "open": []}
    away = by_task.sides(found, "sumo", "crashed", ("replica", "risky"))
    assert away == {"less": ["u-turn"], "more": [], "open": []}


def test_settings_in_which_gates_fail_are_named() -> None:
    rows = [("two-way", "5+2", k < 1) for k in range(3)] + [("u-turn", "3", k < 2) for k in range(3)]
    gates = pd.DataFrame([*rows, ("u-turn", "3", None)], columns=["task", "level_name", "passed"])
    assert by_task.failing(gates, 0.5) == {
        "passed": 3,
        "of": 7,
        "named": {"two-way 5+2": (1, 3)},
        "rest": (2, 4),
    }


def test_a_setting_that_no_rule_survives_is_named_with_its_best_driver() -> None:
    place = {"backend": "sumo", "arm": "", "traffic": "regular"}
    rates = {("two-way", "5+2"): (0.9, 1.0), ("u-turn", "3"): (0.0, 1.0)}
    rows = [
        {**place, "task": task, "level_name": name, "policy": policy, "crashed": rate}
        for (task, name), both in rates.items()
        for policy, rate in zip(("careful", "faster"), both, strict=True)
    ]
    agent = {**rows[0], "arm": "control", "crashed": 0.2}
    risky = {**rows[2], "traffic": "risky", "crashed": 1.0}
    assert by_task.hopeless(analysis(policies=pd.DataFrame([*rows, agent, risky])), "sumo") == {
        "two-way 5+2": 0.9
    }
