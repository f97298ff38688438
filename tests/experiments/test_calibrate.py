"""The command that fits SUMO's drivers and the dose of risk, end to end on a few scenarios."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest
from rich.console import Console

from experiments.calibrate import WITHOUT_EVENTS, Options, calibrate, show
from experiments.validation.checks import REFERENCE
from experiments.validation.parts import Engine


@pytest.fixture
def options(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Options:
    """SUMO stands for highway-env, so that both sides are quick."""
    sumo = Engine("sumo", "sumo", stamps={"u-turn": "now"})
    both = sumo, replace(sumo, name=REFERENCE)
    monkeypatch.setattr("experiments.calibrate.engines", lambda options, task: both)
    return Options(tmp_path, tasks=("u-turn",), reference="sumo", trials=3, scenarios=3, test=4, workers=1)


@pytest.mark.slow
def test_the_present_settings_are_best_where_sumo_is_its_own_reference(options: Options, capsys) -> None:
    result = calibrate(options, Console(width=200))
    assert json.loads((options.out / "calibration.json").read_text()) == result
    for part in ("drivers", "risk"):
        found = result["u-turn"][part]
        assert len(found["trials"]) == 3
        assert found["training"]["found"] <= found["training"]["present"]
        assert set(found["found"]) == set(found["present"])
    assert result["u-turn"]["drivers"]["training"]["present"] == 0.0
    table = pd.read_csv(options.out / "doses.csv")
    assert set(table["engine"]) == {"sumo", WITHOUT_EVENTS, "reference"}
    assert (options.out / "doses.svg").read_text().startswith("<svg")
    show(result, Console(width=200))
    assert "assertive" in capsys.readouterr().out
