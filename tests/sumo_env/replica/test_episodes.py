"""Whole episodes: the replica is highway-env.

`make test-long` drives a thousand of them and prints a table; `PYTHONPATH=. pytest -m long -s <this file>` shows it.
"""

from __future__ import annotations

import pytest

from sumo_env.tasks import TASKS

from .pairs import Case, cases, compare

FEW = {"highway": 4, "two-way": 6, "roundabout": 6, "intersection": 6, "u-turn": 6}
EACH = 200  # episodes of each task in the long comparison


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_some_episodes_are_those_of_highway_env(task: str) -> None:
    chosen = cases(task, FEW[task], seed=1)
    if task == "highway":  # the highest levels take highway-env a minute each
        chosen = [case._replace(level="50") for case in chosen]
    different = {case: found for case in chosen if not (found := compare(case)).is_same}
    assert different == {}


@pytest.mark.slow
@pytest.mark.parametrize("task", [task for task in TASKS if task != "highway"])
def test_so_are_episodes_among_linear_drivers(task: str) -> None:
    chosen = [case._replace(law="linear", risk=0.5 + 0.5 * case.risk) for case in cases(task, 5, seed=2)]
    different = {case: found for case in chosen if not (found := compare(case)).is_same}
    assert different == {}


@pytest.mark.long
@pytest.mark.parametrize("task", TASKS)
def test_99_percent_of_a_thousand_episodes_are_those_of_highway_env(task: str, capsys) -> None:
    """Poses and speeds within 1e-6 after every policy step, the same observations, rewards, endings and measures."""
    found = {case: compare(case) for case in cases(task, EACH)}
    different: dict[Case, object] = {case: outcome for case, outcome in found.items() if not outcome.is_same}
    with capsys.disabled():
        steps, worst = sum(o.steps for o in found.values()), max(o.worst for o in found.values())
        print(
            f"\n{task}: {EACH - len(different)} of {EACH} episodes the same, {steps} steps, worst {worst:.1e}"
        )
        for case, outcome in different.items():
            print(f"  {case}: {outcome}")
    assert len(different) <= 0.01 * EACH
