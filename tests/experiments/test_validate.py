"""The command that compares SUMO with highway-env, on a few scenarios."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from experiments.study import verdict
from experiments.validate import MISSED, Options, tables, validate


@pytest.mark.slow
def test_the_command_writes_what_it_found(tmp_path: Path) -> None:
    options = Options(tmp_path, quick=True, tasks=("u-turn",), levels=(1,), scenarios=3, workers=1)
    record = validate(options, Console(width=200))
    assert json.loads((tmp_path / "validation.json").read_text()) == record
    assert set(record["tasks"]["u-turn"]["traffics"]) == {"regular", "risky"}
    assert record["replica"] is None  # highway-env itself drives nothing in a quick run
    rows = (tmp_path / "validation.html").read_text().count("<tr")
    assert rows == sum(len(table) + 1 for table in tables(record).values())  # each with a head
    assert len(tables(record)["Every check"]) == len(verdict.every_check(record["tasks"]["u-turn"]))
    known = verdict.verdict_of(record)
    assert known["fingerprints"] == record["fingerprints"]
    assert known["tasks"]["u-turn"]["counts"]["missed"] == len(tables(record)[MISSED])
