"""The dose-response table: more dose, more danger, and dose 0 without any."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.calibrate_risk import POLICIES, Options, measure, run
from sumo_env.tasks import TASKS

EPISODES = 6


def dose_response(task: str, doses: tuple[float, ...]) -> pd.DataFrame:
    rows = [row for dose in doses for row in measure("sumo", task, 1, dose, EPISODES)]
    return pd.DataFrame(rows).groupby("dose").first()  # the traffic's measures are the same for all drivers


@pytest.mark.slow
def test_on_the_highway_danger_among_the_traffic_rises_with_the_dose() -> None:
    table = dose_response("highway", (0.0, 0.5, 1.0))
    danger = table["near_misses_per_vehicle_hour"] + table["crashes_per_vehicle_hour"]
    assert danger[0.0] < danger[0.5] < danger[1.0]
    assert table.loc[0.0, "wrecks_per_episode"] == 0.0


@pytest.mark.slow
def test_regular_drivers_keep_to_mobil_and_risky_ones_do_not() -> None:
    table = dose_response("highway", (0.0, 1.0))
    assert table.loc[0.0, "violating_mobil"] < 0.05
    assert table.loc[1.0, "violating_mobil"] > 0.15


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_risky_drivers_brake_harder(task: str) -> None:
    table = dose_response(task, (0.0, 1.0))
    assert table.loc[1.0, "acceleration_p1"] < table.loc[0.0, "acceleration_p1"]


@pytest.mark.slow
@pytest.mark.parametrize("task", sorted(set(TASKS) - {"two-way"}))  # where nearly every ego crashes
def test_risk_endangers_egos_that_keep_to_the_rules(task: str) -> None:
    crashes = {
        dose: sum(
            row["crash_rate"]
            for row in measure("sumo", task, 1, dose, 25)
            if row["policy"] in ("idm", "careful")
        )
        for dose in (0.0, 1.0)
    }
    assert crashes[1.0] > crashes[0.0] + 0.1


def test_the_command_writes_a_row_for_each_simulator_dose_and_driver_and_a_picture(tmp_path: Path) -> None:
    assert run(Options(tmp_path, tasks=("u-turn",), doses=(0.0,), backends=("highway-env",), episodes=2)) == 0
    first = pd.read_csv(tmp_path / "risk.csv")
    assert run(Options(tmp_path, tasks=("u-turn",), doses=(0.0, 1.0), episodes=2)) == 0
    table = pd.read_csv(tmp_path / "risk.csv")
    assert list(table["policy"]) == 4 * [*POLICIES]
    assert set(table["backend"]) == {"sumo", "highway-env"}
    pd.testing.assert_frame_equal(table.iloc[: len(first)], first)  # measured once
    assert np.isfinite(table[["crash_rate", "near_misses_per_vehicle_hour"]].to_numpy()).all()
    assert (tmp_path / "risk.png").stat().st_size > 0
