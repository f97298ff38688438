"""Drivers: what a dose of risk changes and leaves alone, and the SUMO vehicle type that is a driver."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from sumo_env.traffic import drivers as module
from sumo_env.traffic.drivers import (
    MIN_GAIN,
    ONE_STREAM,
    POOL,
    SAFE_BRAKING,
    SPREAD_PARAMETERS,
    Calibration,
    CarFollowing,
    Driver,
    DriverPool,
    RiskRanges,
    quantiles,
    vehicle_type,
)
from tests.sumo_env.scenarios import draw, drivers
from tests.tasks import every_task

BASE = CarFollowing()


def test_dose_zero_is_the_regular_driver() -> None:
    for driver in DriverPool(BASE, 0.0).drivers:
        for name, value in asdict(BASE).items():
            assert getattr(driver, name) == value
        assert driver.gives_way


def test_the_exponent_is_uniform_between_3_5_and_4_5_or_fixed() -> None:
    deltas = sorted(driver.delta for driver in DriverPool(BASE, 0.0).drivers)
    assert np.allclose(deltas, 3.5 + (np.arange(POOL) + 0.5) / POOL)
    assert {driver.delta for driver in DriverPool(BASE, 1.0, True).drivers} == {4.0}


@pytest.mark.parametrize("name", SPREAD_PARAMETERS)
def test_at_dose_one_parameters_fill_half_to_one_and_a_half_times_the_regular_value(name: str) -> None:
    regular = getattr(DriverPool(BASE, 0.0).drivers[0], name)
    values = [getattr(driver, name) / regular for driver in DriverPool(BASE, 1.0).drivers]
    assert min(values) == pytest.approx(0.5, abs=0.01)
    assert max(values) == pytest.approx(1.5, abs=0.01)
    assert np.mean(values) == pytest.approx(1.0)


@pytest.mark.parametrize(("dose", "low", "high"), [(0.0, 1.0, 1.0), (0.5, 0.7, 1.1), (1.0, 0.4, 1.2)])
def test_a_task_may_have_ranges_of_its_own(dose: float, low: float, high: float) -> None:
    pool = DriverPool(BASE, dose, False, RiskRanges(tau=(0.4, 1.2), not_giving_way=0.25)).drivers
    values = [driver.tau / BASE.tau for driver in pool]
    assert (min(values), max(values)) == pytest.approx((low, high), abs=0.01)
    assert sum(not driver.gives_way for driver in pool) == POOL * 0.25 * dose
    assert [d.accel for d in pool] == [d.accel for d in DriverPool(BASE, dose).drivers]


def test_a_driver_keeps_its_place_in_the_ranges_at_every_dose() -> None:
    """Common random numbers: driver k of any two doses differs only by the dose."""
    half, full = DriverPool(BASE, 0.5).drivers, DriverPool(BASE, 1.0).drivers
    for name in SPREAD_PARAMETERS:
        regular = getattr(DriverPool(BASE, 0.0).drivers[0], name)
        deviations = [[getattr(driver, name) - regular for driver in pool] for pool in (half, full)]
        assert np.allclose(2.0 * np.array(deviations[0]), deviations[1])
    assert [driver.attention for driver in half] == [driver.attention for driver in full]
    careless = [{k for k, driver in enumerate(pool) if not driver.gives_way} for pool in (half, full)]
    assert [len(group) for group in careless] == [POOL // 4, POOL // 2] and careless[0] <= careless[1]


def test_a_parameter_more_has_a_stream_of_its_own_and_shifts_no_other_draw(monkeypatch) -> None:
    before = DriverPool(BASE, 0.5).drivers
    assert sorted(quantiles("politeness")) == [(k + 0.5) / POOL for k in range(POOL)]
    assert not any(np.array_equal(quantiles("politeness"), quantiles(name)) for name in ONE_STREAM)
    drawn = {}

    def driver(politeness: float, **known) -> Driver:
        drawn[known["type"]] = politeness
        return Driver(**known)

    monkeypatch.setattr(module, "SPREAD_PARAMETERS", ("politeness", *SPREAD_PARAMETERS))
    monkeypatch.setattr(RiskRanges, "politeness", (0.0, 1.0), raising=False)
    monkeypatch.setattr(module, "Driver", driver)
    assert vars(DriverPool)["drivers"].fget.__wrapped__(DriverPool(BASE, 0.5)) == before  # not from the cache
    assert len(drawn) == len(set(drawn.values())) == POOL


def test_the_counterparts_in_highway_env_are_mobil_s_two_thresholds() -> None:
    regular = DriverPool(BASE, 0.0).drivers[0]
    assert (regular.safe_braking, regular.min_gain) == (SAFE_BRAKING, MIN_GAIN)
    eager = replace(regular, assertive=2.0, speed_gain=2.0)
    assert (eager.safe_braking, eager.min_gain) == (2 * SAFE_BRAKING, MIN_GAIN / 2)


# -- the vehicle type --------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_that_ignores_others_at_junctions_is_drawn_beforehand(share: float) -> None:
    """Probabilities are 0 or 1: SUMO would redraw fractional ones."""
    for dose, careless in ((0.0, 0), (1.0, POOL // 2)):
        pool = DriverPool(BASE, dose).drivers
        for setting, key in (
            (Calibration(ignores_approaching=share), "jmIgnoreFoeProb"),
            (Calibration(ignores_inside=share), "jmIgnoreJunctionFoeProb"),
        ):
            values = [vehicle_type(driver, setting)[key] for driver in pool]
            assert set(values) <= {"0", "1"}
            expected = careless + share * (POOL - careless)
            assert values.count("1") == pytest.approx(expected, abs=4)


@pytest.mark.parametrize("dose", [0.0, 0.3, 1.0])
@every_task
def test_a_task_names_every_driver_that_its_scenarios_may_hold(task: str, dose: float) -> None:
    known = drivers(task, dose)
    assert len({driver.type for driver in known}) == len(known)
    for seed in range(5):
        scenario = draw(task, seed, risk=dose)
        for spec in (*scenario.specs, *(spawn.vehicle for spawn in scenario.spawns)):
            assert spec.is_obstacle or spec.driver in known
