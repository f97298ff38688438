"""What a sweep says about SUMO beside its results."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments.study.design import verdict
from experiments.study.design.fingerprint import dynamics
from experiments.validation.checks import scorecard, summary
from sumo_env.tasks import TASKS
from tests.experiments.validation.tables import compared

TASK = ["u-turn"]


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the package knows: the verdict on the u-turn as it drives now, with misses."""
    tasks = summary(scorecard(compared(crashed=True)), TASK)
    now = {"fingerprints": {"u-turn": dynamics("sumo", "u-turn")}, "versions": verdict.versions()}
    file = tmp_path / "package" / "verdict.json"
    file.parent.mkdir()
    file.write_text(json.dumps({"schema": verdict.SCHEMA, "backend": "sumo", **now, "tasks": tasks}))
    monkeypatch.setattr(verdict, "STORED", file)
    return file


def test_the_stored_verdict_is_kept_beside_results(stored: Path, tmp_path: Path) -> None:
    verdict.copy_verdict("sumo", TASK, tmp_path)
    known = verdict.of_results(tmp_path)
    assert known == json.loads((tmp_path / "verdict.json").read_text())
    assert known["tasks"]["u-turn"]["passed"] is False
    assert "crash rate" in {item["name"] for item in known["tasks"]["u-turn"]["missed"]}


@pytest.mark.parametrize(
    ("others", "backend", "tasks"),
    [
        ({"fingerprints": {"u-turn": "other"}}, "sumo", TASK),
        ({"versions": {"libsumo": "0.0"}}, "sumo", TASK),
        ({"schema": 1}, "sumo", TASK),
        ({}, "sumo", ["u-turn", "highway"]),
        ({}, "highway-env", TASK),
    ],
    ids=str,
)
def test_a_verdict_on_others_is_not(stored: Path, tmp_path: Path, others, backend, tasks) -> None:
    stored.write_text(json.dumps({**json.loads(stored.read_text()), **others}))
    verdict.copy_verdict(backend, tasks, tmp_path)
    assert verdict.of_results(tmp_path) is None


def test_the_package_knows_the_present_dynamics(tmp_path: Path) -> None:
    verdict.copy_verdict("sumo", list(TASKS), tmp_path)
    assert verdict.of_results(tmp_path) is not None
