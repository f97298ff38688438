"""The risk dose: what it changes, what it leaves alone."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from sumo_env.drivers import (
    POOL,
    SPREAD,
    SPREAD_PARAMETERS,
    CarFollowing,
    RiskRates,
    draw_events,
    driver_pool,
)

BASE = CarFollowing()


def test_dose_zero_is_the_regular_driver() -> None:
    for driver in driver_pool(BASE, 0.0):
        for name, value in asdict(BASE).items():
            assert getattr(driver, name) == value
        assert driver.gives_way


def test_the_exponent_is_uniform_between_3_5_and_4_5_or_fixed() -> None:
    deltas = sorted(driver.delta for driver in driver_pool(BASE, 0.0))
    assert np.allclose(deltas, 3.5 + (np.arange(POOL) + 0.5) / POOL)
    assert {driver.delta for driver in driver_pool(BASE, 1.0, True)} == {4.0}


@pytest.mark.parametrize("name", SPREAD_PARAMETERS)
def test_at_dose_one_parameters_fill_the_range_and_keep_their_mean(name: str) -> None:
    regular = getattr(driver_pool(BASE, 0.0)[0], name)
    values = [getattr(driver, name) / regular for driver in driver_pool(BASE, 1.0)]
    assert min(values) == pytest.approx(1 - SPREAD, abs=0.05)
    assert max(values) == pytest.approx(1 + SPREAD, abs=0.05)
    assert np.mean(values) == pytest.approx(1.0)


@pytest.mark.parametrize("name", SPREAD_PARAMETERS)
def test_the_range_widens_with_the_dose(name: str) -> None:
    spreads = [np.ptp([getattr(d, name) for d in driver_pool(BASE, dose)]) for dose in (0.0, 0.25, 0.5, 1.0)]
    assert spreads == sorted(spreads)
    assert spreads[0] == 0.0


def test_half_of_the_drivers_do_not_give_way_at_dose_one_and_the_dose_only_adds_to_them() -> None:
    careless = [
        {k for k, d in enumerate(driver_pool(BASE, dose)) if not d.gives_way} for dose in (0.0, 0.5, 1.0)
    ]
    assert [len(group) for group in careless] == [0, POOL // 4, POOL // 2]
    assert careless[1] <= careless[2]


RATES = RiskRates(cut_in=0.1, brake=0.1, surge=0.1)
VEHICLES = tuple((f"v{k}", 0.0) for k in range(200))


def test_no_events_in_regular_traffic() -> None:
    assert draw_events(RATES, 0.0, VEHICLES, 0, 20.0) == ()


def test_events_come_at_the_rate_of_the_dose_and_a_smaller_dose_has_a_subset() -> None:
    full = draw_events(RATES, 1.0, VEHICLES, 0, 20.0)
    half = draw_events(RATES, 0.5, VEHICLES, 0, 20.0)
    expected = 200 * 20.0 * 0.3  # Poisson, so its standard deviation is the root
    assert abs(len(full) - expected) < 5 * np.sqrt(expected)
    assert abs(len(half) - expected / 2) < 5 * np.sqrt(expected / 2)
    assert set(half) < set(full)


def test_events_are_sorted_and_lie_within_the_episode_and_the_vehicle_s_life() -> None:
    events = draw_events(RATES, 1.0, (("early", 0.0), ("late", 15.0)), 3, 200.0)
    assert [event.time for event in events] == sorted(event.time for event in events)
    assert all(0.0 <= event.time < 200.0 for event in events)
    assert all(event.time >= 15.0 for event in events if event.vehicle == "late")
