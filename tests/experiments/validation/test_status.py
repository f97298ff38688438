"""What a sweep may say about the simulator before training."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments.study import verdict
from experiments.study.fingerprint import fingerprint
from experiments.validation import status
from experiments.validation.checks import REFERENCE, scorecard
from experiments.validation.episodes import CORE
from experiments.validation.parts import Engine, Part
from tests.experiments.validation.tables import compared

KNOWN = {"u-turn": "abc"}


def full_record(table):
    tasks = scorecard(table, "sumo", {"u-turn": ["3", "6", "9", "12"]})
    about = {"schema": verdict.SCHEMA, "backend": "sumo", "scenarios": 40, "command": "validate"}
    return {**about, "fingerprints": KNOWN, "versions": verdict.versions(), "tasks": tasks}


@pytest.fixture
def nothing_stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package that knows neither a validation nor episodes to compare with."""
    monkeypatch.setattr(status, "VERDICT", tmp_path / "verdict.json")
    monkeypatch.setattr(status, "STORED_REFERENCE", tmp_path / "reference.parquet")


@pytest.fixture
def stored(nothing_stored: None, tmp_path: Path) -> Path:
    """A package that knows a validation of the u-turn with misses."""
    table = compared(crashed=True)
    status.store(full_record(table), table, CORE)
    return tmp_path / "verdict.json"


def test_a_stored_verdict_holds_for_the_same_dynamics(stored: Path) -> None:
    known = status.stored_verdict(KNOWN)
    assert known["tasks"]["u-turn"]["passed"] is False
    assert "crash rate" in {item["name"] for item in known["tasks"]["u-turn"]["missed"]}


@pytest.mark.parametrize("others", [{"u-turn": "other"}, {**KNOWN, "highway": "abc"}])
def test_it_does_not_hold_for_others(stored: Path, others: dict[str, str]) -> None:
    assert status.stored_verdict(others) is None


def test_it_does_not_hold_for_another_version_of_sumo(stored: Path) -> None:
    record = json.loads(stored.read_text())
    stored.write_text(json.dumps({**record, "versions": {"libsumo": "0.0"}}))
    assert status.stored_verdict(KNOWN) is None


def test_fingerprints_change_with_the_configuration() -> None:
    assert fingerprint("sumo", "u-turn") != fingerprint("sumo", "u-turn", {"simulation_frequency": 15})


def test_a_validation_beside_the_results_is_used(tmp_path: Path) -> None:
    now = {"u-turn": fingerprint("sumo", "u-turn")}
    (tmp_path / "validation.json").write_text(json.dumps({**full_record(compared()), "fingerprints": now}))
    known = status.before_training("sumo", ["u-turn"], tmp_path)
    assert known["source"].startswith("40 scenarios")
    assert known["tasks"]["u-turn"]["passed"] is True and known["tasks"]["u-turn"]["counts"]["missed"] == 0
    assert not (tmp_path / "verdict.json").exists()


def test_without_anything_to_compare_with_there_is_no_verdict(nothing_stored: None, tmp_path: Path) -> None:
    assert status.before_training("sumo", ["u-turn"], tmp_path) is None
    assert verdict.of_results(tmp_path) is None


@pytest.mark.slow
def test_other_dynamics_are_driven_through_the_stored_scenarios(nothing_stored: None, tmp_path: Path) -> None:
    engine = Engine(REFERENCE, "sumo", egos=("idle", "careful"))
    reference = Part(engine, "u-turn", 1, "regular", range(4)).drive()
    reference.to_parquet(tmp_path / "reference.parquet")
    out = tmp_path / "sweep"
    out.mkdir()
    known = status.before_training("sumo", ["u-turn"], out, 1)
    assert known["source"] == "4 stored scenarios"
    assert known["tasks"]["u-turn"]["passed"] is True  # SUMO is compared with itself here
    assert verdict.of_results(out) == known
    assert status.before_training("sumo", ["u-turn"], out, 1) == known
    assert status.before_training("highway-env", ["u-turn"], out, 1) is None
