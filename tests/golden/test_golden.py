"""Behaviour stays what it was. A change that is meant: regenerate, review the difference (regenerate.py).

Of whole episodes: experiments/study/test_fingerprint.py.
"""

from __future__ import annotations

from tests.golden import scenes
from tests.golden.regenerate import read
from tests.tasks import every_task

SHOWN = 12  # differences in a failure's message; the first ones say most


def report(differences: list[str]) -> str:
    return "\n".join([f"{len(differences)} differences", *differences[:SHOWN]])


@every_task
def test_first_steps_are_the_golden_ones(task: str) -> None:
    found = scenes.differences(scenes.table(task), read(task))
    assert not found, report(found)
