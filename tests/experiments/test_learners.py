"""Learners from elsewhere beside our arms, on the same scenarios."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from experiments.learners import (
    OURS,
    RL_AGENTS,
    STABLE_BASELINES,
    TRAININGS,
    Options,
    cells,
    compare,
)
from experiments.study.design.presets import PRESETS, tuned

LEARNERS = (*OURS, *STABLE_BASELINES, *RL_AGENTS)


@pytest.mark.slow
def test_every_learner_is_trained_once_and_tested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    few = replace(PRESETS["smoke"], learners=tuned({"u-turn": 20}, warm_up=200))
    monkeypatch.setitem(PRESETS, "smoke", few)
    options = Options(tmp_path, preset="smoke", tasks=("u-turn",), seeds=1, episodes=2, workers=1)
    assert compare(options) == 0
    table = capsys.readouterr().out.partition("\nu-turn\n")[2]
    drivers = {line.split()[0]: line for line in table.splitlines()[3:]}
    assert {*LEARNERS, "careful"} <= set(drivers)
    found = cells(options, "u-turn")
    assert {name: len(found[name]) for name in LEARNERS} == dict.fromkeys(LEARNERS, 1)
    assert len({found[name][0].budget[0] for name in LEARNERS}) == 1  # environment steps
    assert all("±" not in drivers[name] for name in LEARNERS)  # one training has no standard error
    stored = pd.read_parquet(tmp_path / TRAININGS).query("learner == 'sb3-ppo' and traffic == 'risky'")
    assert f"{stored['return'].item():.2f}" in drivers["sb3-ppo"].split()
    written = {file: file.stat().st_mtime_ns for file in tmp_path.glob("*/*")}
    assert compare(options) == 0
    assert written == {file: file.stat().st_mtime_ns for file in tmp_path.glob("*/*")}
    assert capsys.readouterr().out.partition("\nu-turn\n")[2] == table
