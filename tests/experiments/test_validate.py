"""The command that compares SUMO with highway-env, on a few scenarios."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from experiments.study import verdict
from experiments.validate import Options, show, validate
from experiments.validation.page import missed


@pytest.mark.slow
def test_the_command_writes_what_it_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = Options(tmp_path, quick=True, tasks=("u-turn",), levels=(1,), scenarios=3, workers=1)
    record = validate(options, Console(width=200))
    assert json.loads((tmp_path / "validation.json").read_text()) == record
    assert set(record["tasks"]["u-turn"]["traffics"]) == {"regular", "risky"}
    assert record["replica"] is None  # highway-env itself drives nothing in a quick run
    page = (tmp_path / "validation.html").read_text()
    show(record, Console(width=200))
    printed = capsys.readouterr().out
    for item in missed(record):
        assert item["where"] in page and item["where"] in printed
    known = verdict.read(tmp_path / "validation.json")
    assert known["fingerprints"] == record["fingerprints"]
