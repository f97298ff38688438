"""Validation on a few scenarios and what it stores of whole tasks; what a dose does, by the same episodes."""

import json
import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import experiments.validate
from experiments import doses
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
    monkeypatch.setattr(experiments.validate, "JUDGED", tmp_path / "validation.csv")
    driven = pd.concat(episodes(name, level=level) for name in (SUMO, REFERENCE) for level in (1, 2, 3, 4))
    monkeypatch.setattr(experiments.validation.episodes, "run", lambda *_: driven)
    record = validate(Options(tmp_path, tasks=("u-turn",), update=True))
    judged = pd.read_csv(tmp_path / "validation.csv")
    assert len(judged) == sum(record["tasks"]["u-turn"]["counts"].values())
    assert json.loads(stored.read_text()) == {**before, "u-turn": record["tasks"]["u-turn"]} != before
    key = {"task": "u-turn", "dynamics": dynamics("sumo", "u-turn")}
    versions = record["tasks"]["u-turn"]["versions"]
    assert verdict.verdicts([{"key": key, "versions": versions}]) == record["tasks"]
    assert verdict.verdicts([{"key": {**key, "dynamics": "other"}, "versions": {}}]) == {}


# -- what a dose does -------------------------------------------------------------------------------------------------

WHERE = ["engine", "task", "traffic", "ego"]


def test_a_rate_is_of_the_episodes_of_one_simulator_dose_and_ego(tmp_path, monkeypatch, here: None) -> None:
    rates = {"regular": 0.1, "dose50": 0.25, "risky": 0.5}

    def driven(engine: str, traffic: str, other: float) -> pd.DataFrame:
        def crashed(ego: str, scenario: int) -> bool:
            return scenario < 40 * (rates[traffic] if ego == "careful" else other)

        return episodes(engine, traffic=traffic, crashed=crashed)

    others = {"sumo": 1.0, REFERENCE: 0.0}
    every = pd.concat(driven(engine, traffic, other) for engine, other in others.items() for traffic in rates)
    monkeypatch.setattr(doses.episodes, "run", lambda *_: every)
    found = doses.doses(doses.Options(tmp_path, tasks=("u-turn",)))
    for engine, other in others.items():
        for traffic, rate in rates.items():
            rows = found[(found["engine"] == engine) & (found["traffic"] == traffic)].set_index("ego")
            assert rows.loc["careful", "crash_rate"] == rate and rows.loc["idle", "crash_rate"] == other
            assert set(rows["episodes"]) == {40}
    assert len(found) == len(every.groupby(WHERE)) == len(pd.read_csv(tmp_path / "doses.csv"))


@pytest.mark.slow
def test_without_events_dose_0_is_the_same_and_dose_1_is_not(tmp_path: Path, monkeypatch, here: None) -> None:
    monkeypatch.setattr(doses, "DOSES", ("regular", "risky"))
    doses.doses(doses.Options(tmp_path, tasks=("u-turn",), scenarios=3, workers=1))
    table = pd.read_csv(tmp_path / "doses.csv")
    assert set(table["engine"]) == {engine.name for engine in doses.ENGINES}
    own, silent = (
        table[table["engine"] == engine.name].set_index(["traffic", "ego"]).drop(columns="engine")
        for engine in doses.ENGINES[:2]
    )
    pd.testing.assert_frame_equal(own.loc["regular"], silent.loc["regular"])
    assert not own.loc["risky"].equals(silent.loc["risky"])
