"""Behaviour stays what it was. A change that is meant: regenerate, review the difference (README.md here)."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Any

import pytest

from sumo_env.tasks import TASKS
from tests.golden import outcomes, scenes
from tests.golden.regenerate import read
from tests.tasks import every_task

SHOWN = 12  # differences in a failure's message; the first ones say most


def report(differences: list[str]) -> str:
    return "\n".join([f"{len(differences)} differences", *differences[:SHOWN]])


@every_task
def test_first_steps_are_the_golden_ones(task: str) -> None:
    found = scenes.differences(scenes.table(task), read(f"scenes/{task}.json"))
    assert not found, report(found)


def cells() -> Iterator[Any]:
    """Every day at both levels and in both traffics, the two between them of the four before a release."""
    for task in TASKS:
        first, *between, last = scenes.cells(task)
        for cell in (first, *between, last):
            yield pytest.param(task, *cell, marks=[pytest.mark.long] if cell in between else [])


@pytest.mark.slow
@pytest.mark.parametrize(("task", "level", "risk"), list(cells()))
def test_episodes_end_as_the_golden_ones(task: str, level: str, risk: float) -> None:
    golden = read(f"outcomes/{task}.json")[f"level {level}, risk {risk:g}"]
    found = outcomes.differences(outcomes.drive(task, level, risk), golden)
    assert not found, report(found)


# -- the comparison can fail -------------------------------------------------------------------------------


def test_a_vehicle_that_is_two_micrometres_away_or_missing_is_noticed() -> None:
    golden = read("scenes/u-turn.json")
    moved = copy.deepcopy(golden)
    vehicles = next(iter(moved.values()))[2]["vehicles"]
    vehicles["v0"][1] += 2e-6
    (line,) = scenes.differences(moved, golden)
    assert "/2/vehicles/v0/1: " in line
    del vehicles["v0"]
    (line,) = scenes.differences(moved, golden)
    assert "/2/vehicles/v0/0" in line


def test_regular_traffic_does_not_end_as_risky_traffic() -> None:
    for task in TASKS:
        regular, risky, *_ = read(f"outcomes/{task}.json").values()
        assert outcomes.differences(regular, risky), task
