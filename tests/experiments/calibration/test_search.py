"""The search: from the present settings, within bounds, and on after an interruption."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path

import pytest

from experiments.calibration.search import search
from experiments.calibration.spaces import DRIVERS, RISK, Range, changes_of_risk, present_risk
from sumo_env.tasks import TASKS
from sumo_env.traffic.drivers import RISK_RANGES, RiskRanges

SPACE = {"x": Range(0.0, 10.0), "on": (False, True)}
START = {"x": 9.0, "on": False}


def objective(settings: dict) -> float:
    return (settings["x"] - 3.0) ** 2 + (not settings["on"])


def test_finds_better_settings_than_those_it_starts_from(tmp_path: Path) -> None:
    study = search(SPACE, objective, START, 40, tmp_path / "a.journal")
    assert study.trials[0].params == START
    assert study.best_value < 1.0
    assert study.best_params["on"] is True
    assert all(0.0 <= trial.params["x"] <= 10.0 for trial in study.trials)


def test_goes_on_where_it_was_stopped(tmp_path: Path) -> None:
    asked: list[dict] = []

    def counted(settings: dict) -> float:
        if len(asked) == 5:
            raise KeyboardInterrupt
        asked.append(settings)
        return objective(settings)

    with pytest.raises(KeyboardInterrupt):
        search(SPACE, counted, START, 12, tmp_path / "a.journal")
    more: list[dict] = []
    study = search(SPACE, lambda s: more.append(s) or objective(s), START, 12, tmp_path / "a.journal")
    assert len(more) == 12 - len(asked)
    values = [trial.value for trial in study.trials if trial.value is not None]
    assert len(values) == 12


def test_what_is_searched_exists_for_every_task() -> None:
    assert set(DRIVERS) == set(RISK) == set(TASKS)
    for name, task in TASKS.items():
        assert set(DRIVERS[name]) <= set(asdict(task.calibration))
        assert set(RISK[name]) <= set(present_risk(task))


def test_ranges_of_a_tasks_own_are_searched() -> None:
    for name, task in TASKS.items():
        own = {
            field.name
            for field in fields(RiskRanges)
            if getattr(task.risk_ranges, field.name) != getattr(RISK_RANGES, field.name)
        }
        assert own <= set(RISK[name])


def test_the_lower_end_of_a_range_is_searched_and_its_upper_end_kept() -> None:
    task = TASKS["u-turn"]
    assert present_risk(task)["tau"] == task.risk_ranges.tau[0]
    assert changes_of_risk(task, {"tau": 0.7, "cut_in": 0.3}) == {
        "tau": (0.7, task.risk_ranges.tau[1]),
        "cut_in": 0.3,
    }
