"""Learners from elsewhere on the same scenarios."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments.learners import LEARNERS, Options, Training, table, trainings
from experiments.support.errors import UserError


@pytest.mark.parametrize("learner", LEARNERS)
def test_every_learner_is_trained_and_tested(learner: str, tmp_path: Path) -> None:
    training = Training(learner, "u-turn", 0, 260, 2, tmp_path)
    training.compute()
    assert training.file.exists()
    assert table([training], None).index.tolist() == [("u-turn", learner)]


def test_what_does_not_exist_is_named() -> None:
    with pytest.raises(UserError, match=r"did you mean .sb3"):
        trainings(Options(learners=("sb4",)))
