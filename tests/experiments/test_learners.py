"""Learners from elsewhere on the same scenarios."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from experiments.learners import LEARNERS, Training, settings_of, table
from experiments.support.errors import UserError


@pytest.mark.parametrize("learner", LEARNERS)
def test_every_learner_is_trained_and_tested(learner: str, tmp_path: Path) -> None:
    training = Training(learner, "u-turn", 0, 260, 2, "01234567", tmp_path)
    beats: list[float] = []
    training.compute(beats.append)
    assert training.done() and beats
    assert table([training], None).splitlines()[2].startswith(f"| u-turn | {learner} | 1 | ")
    assert replace(training, steps=261).name != training.name


def test_what_does_not_exist_is_named() -> None:
    with pytest.raises(UserError, match=r"did you mean .sb3-tuned"):
        settings_of("sb3-tune", 1000)
