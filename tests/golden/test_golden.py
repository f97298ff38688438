"""Behaviour stays what it was. A change that is meant: regenerate, review the difference (regenerate.py).

Of whole episodes: experiments/study/test_fingerprint.py.
"""

from tests.golden import scenes
from tests.golden.regenerate import read
from tests.tasks import every_task


@every_task
def test_first_steps_are_the_golden_ones(task: str) -> None:
    found = scenes.differences(scenes.table(task), read(task))
    assert not found, "\n".join([f"{len(found)} differences", *found[:12]])  # the first ones say most
