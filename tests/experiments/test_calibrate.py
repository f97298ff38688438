"""Fitting SUMO's drivers and the dose of risk: what is made small, the search, and the command on a few scenarios."""

from __future__ import annotations

import json
from dataclasses import asdict

import pandas as pd
import pytest

from experiments import calibrate
from experiments.calibrate import Options
from experiments.study.design.sheet import SHEETS, SWITCH, Between, Space
from experiments.validation.checks import REFERENCE
from experiments.validation.episodes import Engine
from sumo_env.tasks import TASKS
from tests.experiments.validation.tables import compared, episodes

SPACE: Space = {"x": Between(0.0, 10.0), "on": SWITCH}
START = {"x": 9.0, "on": False}


def test_distance_grows_with_the_difference() -> None:
    assert calibrate.drivers_distance(compared(), "u-turn") == pytest.approx(0.0)
    near, far = (
        calibrate.drivers_distance(compared(traffic_speed=speed), "u-turn") for speed in (10.3, 12.0)
    )
    assert 0.0 < near < far


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


def objective(settings: dict) -> float:
    return (settings["x"] - 3.0) ** 2 + (not settings["on"])


def test_the_same_search_takes_the_same_way_and_begins_with_the_present_settings() -> None:
    def asked(trials: int) -> list[dict]:
        return [trial.params for trial in calibrate.minimise(SPACE, objective, START, trials).trials]

    once = asked(15)
    assert once[0] == START and min(map(objective, once)) < objective(START)
    assert asked(12) == once[:12]


def test_what_is_searched_exists_for_every_task() -> None:
    assert set(SHEETS) == set(TASKS)
    for name, task in TASKS.items():
        assert set(SHEETS[name].drivers) <= set(asdict(task.calibration))
        assert set(SHEETS[name].risk) <= set(calibrate.present_risk(task))


def test_the_lower_end_of_a_range_is_searched_and_its_upper_end_kept() -> None:
    task = TASKS["u-turn"]
    assert calibrate.present_risk(task)["tau"] == task.risk_ranges.tau[0]
    assert calibrate.risk_options(task, {"tau": 0.7, "cut_in": 0.3}) == {
        "risk_rates": {"cut_in": 0.3},
        "risk_ranges": {"tau": (0.7, task.risk_ranges.tau[1])},
    }


@pytest.mark.slow
def test_the_present_settings_are_best_where_sumo_is_its_own_reference(tmp_path, monkeypatch, here) -> None:
    monkeypatch.setattr(calibrate, "HIGHWAY_ENV", Engine(REFERENCE, "sumo"))  # both sides are quick
    options = Options(tmp_path, tasks=("u-turn",), trials=2, scenarios=2, workers=1)
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
