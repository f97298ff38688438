"""The command on a few scenarios, and what it stores of whole tasks."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import experiments.validate
from experiments.study.design import verdict
from experiments.study.design.fingerprint import dynamics
from experiments.validate import OUTSIDE, Options, tables, validate
from experiments.validation.checks import REFERENCE, SUMO
from tests.experiments.validation.tables import episodes


@pytest.mark.slow
def test_the_command_writes_what_it_found(tmp_path: Path, here: None) -> None:
    few: dict[str, Any] = {"tasks": ("u-turn",), "levels": (1,), "scenarios": 3}
    record = validate(Options(tmp_path, quick=True, **few, workers=1))
    assert json.loads((tmp_path / "validation.json").read_text()) == record
    assert {item["traffic"] for item in record["checks"]} == {"regular", "risky"}
    assert record["replica"] == {}  # highway-env itself drives nothing in a quick run
    rows = (tmp_path / "validation.html").read_text().count("<tr")
    assert rows == sum(len(table) + 1 for table in tables(record).values() if len(table))  # with heads
    assert len(record["tasks"]["u-turn"]["outside"]) == len(tables(record)[OUTSIDE])


def test_an_update_stores_the_driven_tasks_and_keeps_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stored = tmp_path / "verdict.json"
    shutil.copy(verdict.STORED, stored)
    before = json.loads(stored.read_text())
    for module in (experiments.validate, verdict):
        monkeypatch.setattr(module, "STORED", stored)
    driven = pd.concat(episodes(name, level=level) for name in (SUMO, REFERENCE) for level in (1, 2, 3, 4))
    monkeypatch.setattr(experiments.validation.episodes, "run", lambda *_: driven)
    record = validate(Options(tmp_path, tasks=("u-turn",), update=True))
    assert json.loads(stored.read_text()) == {**before, "u-turn": record["tasks"]["u-turn"]} != before
    key = {"task": "u-turn", "dynamics": dynamics("sumo", "u-turn")}
    assert verdict.verdicts([{"key": key, "versions": verdict.versions()}]) == record["tasks"]
    assert verdict.verdicts([{"key": {**key, "dynamics": "other"}, "versions": {}}]) == {}
