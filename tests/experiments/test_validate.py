"""The command that compares SUMO with highway-env, on a few scenarios."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

import experiments.validate
from experiments.study.design import verdict
from experiments.study.design.fingerprint import dynamics
from experiments.validate import MISSED, Options, tables, validate


@pytest.mark.slow
def test_the_command_writes_what_it_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiments.validate, "STORED", tmp_path / "verdict.json")
    few: dict[str, Any] = {"tasks": ("u-turn",), "levels": (1,), "scenarios": 3}
    record = validate(Options(tmp_path, quick=True, **few, workers=1, update=True))
    assert json.loads((tmp_path / "validation.json").read_text()) == record
    assert {item["traffic"] for item in record["checks"]} == {"regular", "risky"}
    assert record["replica"] == {}  # highway-env itself drives nothing in a quick run
    rows = (tmp_path / "validation.html").read_text().count("<tr")
    assert rows == sum(len(table) + 1 for table in tables(record).values())  # each with a head
    assert record["tasks"]["u-turn"]["counts"]["missed"] == len(tables(record)[MISSED])
    stored = json.loads((tmp_path / "verdict.json").read_text())
    assert stored == {name: record[name] for name in stored}
    monkeypatch.setattr(verdict, "STORED", tmp_path / "verdict.json")
    key = {"task": "u-turn", "dynamics": dynamics("sumo", "u-turn")}
    assert verdict.verdicts([{"key": key, "versions": verdict.versions()}]) == record["tasks"]
