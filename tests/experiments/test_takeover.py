"""The command that compares two drivers from equal critical moments."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from PIL import Image

from experiments import takeover
from experiments.study.compute.entrants import entrant_of, several
from experiments.study.compute.takeover import COLUMNS
from experiments.support.errors import UserError
from experiments.support.files import read_json

OPTIONS = takeover.Options("faster", "careful", "u-turn", traffics=("risky",), scenarios=3)


@pytest.fixture(autouse=True)
def few(here: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(takeover, "BATCH", 2)


@pytest.mark.slow
def test_answers_are_written_and_the_command_goes_on_where_it_was_stopped(tmp_path: Path, capsys) -> None:
    options = replace(OPTIONS, out=tmp_path, first_scenario=3)
    assert takeover.takeover(options, ["faster", "careful"]) == 0
    said, files = capsys.readouterr().out, {path: path.stat() for path in (tmp_path / "episodes").iterdir()}
    assert len(files) == 2 and "skill, faster leads" in said and "crashes of careful, leading" in said
    rows = pd.read_parquet(tmp_path / "moments.parquet")
    assert list(rows) == list(COLUMNS) and len(rows) == 6 and {*rows["scenario"]} == {*range(3, 6)}
    found = read_json(tmp_path / "takeover.json")
    answers = {row["question"]: row for row in found["answers"]}
    danger = (rows["moment"].notna() | rows["sudden"]).groupby(rows["leader"]).mean()
    assert [answers["caution"][name] for name in "ab"] == [danger["a"], danger["b"]]
    assert found["questions"][0]["config"]["duration"] == 10 and "within 5 s to the end" in said
    assert answers["skill"]["status"] == "too few" and found["claims"][0]["skill"] == "too few"
    assert pd.read_csv(tmp_path / "takeover.csv")["question"].tolist() == [*answers]
    assert "<svg" in (tmp_path / "takeover.svg").read_text()
    with Image.open(tmp_path / "takeover.gif") as film:
        assert film.n_frames > 10
    next(iter(files)).write_bytes(b"damaged")
    assert takeover.takeover(options, ["faster", "careful"]) == 0
    assert read_json(tmp_path / "takeover.json")["answers"] == found["answers"]
    again = {path: path.stat() for path in (tmp_path / "episodes").iterdir()}
    assert again.keys() == files.keys() and sum(again[path] != files[path] for path in files) == 1


def test_agents_of_a_directory_are_paired_by_training_seed(tmp_path: Path, monkeypatch) -> None:
    """Where one is asked for, the last one drives."""
    (tmp_path / "cells").mkdir()
    key: dict[str, Any] = {"kind": "agent", "backend": "sumo", "task": "u-turn", "level_name": "3"}
    key["env_config"] = {"observation": {"type": "Kinematics"}}
    records = {
        f"{arm}-s{seed}": {"key": {**key, "seed": seed}, "timing": {"finished": f"{seed:02}"}}
        for arm in ("control", "treatment")
        for seed in (11, 9)
    }
    records["control-s1"] = {"key": {**key, "level_name": "12", "seed": 1}, "timing": {"finished": "1"}}
    store = SimpleNamespace(agents=lambda: records, records=lambda: records, weights=lambda name: tmp_path)
    monkeypatch.setattr("experiments.study.compute.entrants.Store", lambda _: store)
    found = several(f"idle,{tmp_path}/control", "u-turn", "3")
    assert [one.name for one in found] == ["idle", "control-s9", "control-s11"]
    assert (
        takeover.observation_of(found) == key["env_config"] == entrant_of(str(tmp_path), "u-turn", "3").config
    )
    before = entrant_of(str(tmp_path), "u-turn", "3")
    records["later"] = {"key": key, "timing": {"finished": "12"}}  # as the folder is trained in
    assert (before.name, entrant_of(str(tmp_path), "u-turn", "3").name) == ("treatment-s11", "later")
    with pytest.raises(UserError, match="trained for highway"):
        entrant_of(str(tmp_path), "highway", "50")
    records["treatment-s9"]["key"]["env_config"] = {
        "observation": {"type": "Kinematics", "vehicles_count": 3}
    }
    with pytest.raises(UserError, match="different observations"):
        takeover.observation_of([*found, *several(f"{tmp_path}/treatment", "u-turn", "3")])
    with pytest.raises(UserError, match="no agent of u-turn 3"):
        several(f"{tmp_path}/mixed", "u-turn", "3")
