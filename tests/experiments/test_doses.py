"""What a dose does: rates by simulator, dose and ego, and that events act at a dose alone."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest

from experiments import doses
from experiments.validation.checks import REFERENCE
from tests.experiments.validation.tables import episodes

WHERE = ["engine", "task", "traffic", "ego"]


def test_a_rate_is_of_the_episodes_of_one_simulator_dose_and_ego(tmp_path, monkeypatch) -> None:
    rates = {"regular": 0.1, "dose50": 0.25, "risky": 0.5}

    def driven(engine: str, traffic: str, other: float) -> pd.DataFrame:
        def crashed(ego: str, scenario: int) -> bool:
            return scenario < 40 * (rates[traffic] if ego == "careful" else other)

        return episodes(engine, traffic=traffic, crashed=crashed)

    others = {"sumo": 1.0, REFERENCE: 0.0}
    every = pd.concat(driven(engine, traffic, other) for engine, other in others.items() for traffic in rates)
    monkeypatch.setattr(doses.episodes, "run", lambda *_: every)
    monkeypatch.setattr(doses, "check_dynamics", lambda _: None)
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
    monkeypatch.setattr(doses, "check_dynamics", lambda _: None)
    doses.doses(doses.Options(tmp_path, tasks=("u-turn",), scenarios=3, workers=1))
    table = pd.read_csv(tmp_path / "doses.csv")
    assert set(table["engine"]) == {engine.name for engine in doses.ENGINES}
    own, silent = (
        table[table["engine"] == engine.name].set_index(["traffic", "ego"]).drop(columns="engine")
        for engine in doses.ENGINES[:2]
    )
    pd.testing.assert_frame_equal(own.loc["regular"], silent.loc["regular"])
    assert not own.loc["risky"].equals(silent.loc["risky"])
