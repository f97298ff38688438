"""Fitting SUMO's drivers and the dose of risk: what is made small, the search, and the command on a few scenarios."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import experiments.validate
from experiments import calibrate
from experiments.study.design import verdict
from experiments.study.design.fingerprint import dynamics
from experiments.validate import OUTSIDE, Options, tables, validate
from experiments.validation.checks import REFERENCE, SUMO
from experiments.validation.episodes import Engine
from tests.experiments.validation.tables import compared, episodes


def responses(engine: str, careful: tuple[float, float, float]) -> pd.DataFrame:
    """Episodes in which the careful ego crashes at these rates at the three doses, the others always."""
    parts = []
    for traffic, rate in zip(calibrate.SEARCHED, careful, strict=True):

        def crashed(ego: str, scenario: int, rate: float = rate) -> bool:
            return scenario < 40 * rate if ego == "careful" else True

        parts.append(episodes(engine, traffic=traffic, crashed=crashed))
    return pd.concat(parts)


@pytest.mark.parametrize(
    ("sumo", "reference", "good"),
    [
        ((0.0, 0.1, 0.2), (0.0, 0.1, 0.2), True),
        ((0.0, 0.1, 0.2), (0.2, 0.3, 0.4), False),  # the simulators differ
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), False),  # the dose does nothing
        ((0.0, 0.5, 0.9), (0.0, 0.5, 0.9), False),  # the dose does too much
        ((0.0, 0.3, 0.2), (0.0, 0.3, 0.2), False),  # a smaller dose does more
    ],
)
def test_a_dose_does_what_it_shall(sumo, reference, good) -> None:
    table = pd.concat([responses("sumo", sumo), responses(REFERENCE, reference)])
    assert (calibrate.dose_distance(table, "u-turn") < 0.01) is good


def test_sumo_is_as_far_away_above_the_reference_as_below_it() -> None:
    table = compared()
    sides = [table["return"] + step * (table["engine"] == SUMO) for step in (0.5, -0.5, 0.0)]
    above, below, same = (
        calibrate.drivers_distance(table.assign(**{"return": side}), "u-turn") for side in sides
    )
    assert above == pytest.approx(below) and same == 0.0 < below


def test_settings_are_judged_on_other_scenarios_than_those_they_are_fitted_on(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(calibrate.episodes, "run", lambda parts, *_: [part.scenarios[0] for part in parts])
    monkeypatch.setattr(calibrate, "drivers_distance", lambda firsts, task: float(min(firsts)))
    found = calibrate.search(calibrate.Options(tmp_path, trials=1, scenarios=5), "drivers", "u-turn")
    assert found and [(own["training"], own["judged"]) for own in found.values()] == [(1000.0, 0.0)] * 2


@pytest.mark.slow
def test_the_present_settings_are_best_where_sumo_is_its_own_reference(tmp_path, monkeypatch, here) -> None:
    monkeypatch.setattr(calibrate, "HIGHWAY_ENV", Engine(REFERENCE, "sumo"))  # both sides are quick
    monkeypatch.setattr(calibrate, "DOSES", calibrate.DOSES[::2])
    options = calibrate.Options(tmp_path, tasks=("u-turn",), trials=2, scenarios=1, workers=1)
    result = calibrate.calibrate(options)
    assert json.loads((tmp_path / "calibration.json").read_text()) == result
    for part in ("drivers", "risk"):
        present, found = (result["u-turn"][part][name] for name in ("present", "found"))
        assert found["training"] <= present["training"]
        assert set(found["settings"]) == set(present["settings"])
    assert result["u-turn"]["drivers"]["present"]["training"] == 0.0
    table = pd.read_csv(tmp_path / "doses.csv")
    assert set(table["engine"]) == {"sumo", calibrate.WITHOUT_EVENTS, "reference"}
    assert set(table["traffic"]) == set(calibrate.DOSES)


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
