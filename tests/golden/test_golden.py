"""Behaviour stays what it was. A change that is meant: regenerate, review the difference (README.md here)."""

from __future__ import annotations

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


@pytest.mark.long
@pytest.mark.parametrize(
    ("task", "level", "risk"), [(task, *cell) for task in TASKS for cell in scenes.cells(task)]
)
def test_episodes_end_as_the_golden_ones(task: str, level: str, risk: float) -> None:
    """Before a release; every day study/test_fingerprint.py holds whole episodes of these tasks."""
    golden = read(f"outcomes/{task}.json")[f"level {level}, risk {risk:g}"]
    found = outcomes.differences(outcomes.drive(task, level, risk), golden)
    assert not found, report(found)
