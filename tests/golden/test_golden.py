"""Behaviour stays what it was. A change that is meant: regenerate, review the difference (README.md here)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from sumo_env.tasks import TASKS
from tests.golden import outcomes, scenes
from tests.golden.regenerate import read
from tests.tasks import PUBLISHED, every_task

SHOWN = 12  # differences in a failure's message; the first ones say most


def report(differences: list[str]) -> str:
    return "\n".join([f"{len(differences)} differences", *differences[:SHOWN]])


@every_task
def test_first_steps_are_the_golden_ones(task: str) -> None:
    found = scenes.differences(scenes.table(task), read(f"scenes/{task}.json"))
    assert not found, report(found)


def cells() -> Iterator[Any]:
    """Every day the densest risky traffic; of published tasks, whose fingerprints hold more, the others are long."""
    for task in TASKS:
        *others, densest = scenes.cells(task)
        marks = [pytest.mark.long] if task in PUBLISHED else []
        yield from (pytest.param(task, *cell, marks=marks) for cell in others)
        yield pytest.param(task, *densest)


@pytest.mark.slow
@pytest.mark.parametrize(("task", "level", "risk"), list(cells()))
def test_episodes_end_as_the_golden_ones(task: str, level: str, risk: float) -> None:
    golden = read(f"outcomes/{task}.json")[f"level {level}, risk {risk:g}"]
    found = outcomes.differences(outcomes.drive(task, level, risk), golden)
    assert not found, report(found)
