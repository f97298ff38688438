"""Whole episodes: the replica is highway-env.

`make test-long` drives a thousand of them; `PYTHONPATH=. pytest -m long -s <this file>` prints those that differ.
"""

from __future__ import annotations

import pytest

from tests.tasks import OF_HIGHWAY_ENV, highway_env_task

from .pairs import Case, cases, compare

FEW = 3  # every day
EACH = 200  # episodes of each task in the long comparison


def different(chosen: list[Case]) -> dict[Case, str]:
    """The episodes that are not those of highway-env, and what differs first.

    Poses and speeds are within 1e-6 after every policy step, observations, rewards, endings and measures the same.
    """
    return {case: found for case in chosen if (found := compare(case))}


@pytest.mark.slow
@highway_env_task
def test_some_episodes_are_those_of_highway_env(task: str) -> None:
    chosen = cases(task, FEW, seed=1)
    if task == "highway":  # the highest levels take highway-env a minute each
        chosen = [case._replace(level="50") for case in chosen]
    assert different(chosen) == {}


@pytest.mark.slow
@pytest.mark.parametrize("task", [task for task in OF_HIGHWAY_ENV if task != "highway"])
def test_so_are_episodes_among_linear_drivers(task: str) -> None:
    chosen = [case._replace(law="linear", risk=0.5 + 0.5 * case.risk) for case in cases(task, FEW, seed=2)]
    assert different(chosen) == {}


@pytest.mark.long
@highway_env_task
def test_99_percent_of_a_thousand_episodes_are_those_of_highway_env(task: str) -> None:
    found = different(cases(task, EACH))
    print(f"{task}: {EACH - len(found)} of {EACH} episodes the same", *found.items(), sep="\n")
    assert len(found) <= 0.01 * EACH
