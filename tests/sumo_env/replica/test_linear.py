"""The second law of risk: the paper's equations are highway-env's ``LinearVehicle.randomize_behavior``."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.vehicle.behavior import LinearVehicle

from experiments.backends import make_env
from experiments.backends.highway_env_vehicle import LinearScenarioVehicle
from sumo_env.replica import linear
from sumo_env.tasks import TASKS
from sumo_env.traffic.scenario import Scenario


def drawn(seed: int = 0, risk: float = 1.0, task: str = "highway", law: str = "linear") -> Scenario:
    env: Any = make_env("replica", task, {"risk_law": law, "risk": risk})
    env.reset(seed=seed)
    scenario: Scenario = env.unwrapped.scenario
    return scenario


def test_ranges_are_highway_env_s_widened_about_the_same_means() -> None:
    vehicle, w = LinearVehicle, linear.WIDENING
    np.testing.assert_allclose(linear.ACCELERATION, vehicle.ACCELERATION_PARAMETERS)
    np.testing.assert_allclose(linear.STEERING, vehicle.STEERING_PARAMETERS)
    half = linear.ACCELERATION * linear.ACCELERATION_SPREAD, linear.STEERING_SPREAD
    np.testing.assert_allclose(vehicle.ACCELERATION_RANGE, linear.ACCELERATION + np.outer((-1, 1), half[0]))
    np.testing.assert_allclose(vehicle.STEERING_RANGE, linear.STEERING + np.outer((-1, 1), half[1]))
    assert vehicle.TIME_WANTED == linear.TIME_WANTED
    drivers = [driver for seed in range(20) for driver in linear.linear_drivers(drawn(seed)).values()]
    for values, mean, spread in (
        (np.array([driver.acceleration for driver in drivers]), linear.ACCELERATION, half[0]),
        (np.array([driver.steering for driver in drivers]), linear.STEERING, half[1]),
    ):
        assert (abs(values - mean) <= w * spread).all() and (values > 0.0).all()
        np.testing.assert_allclose(values.mean(axis=0), mean, atol=0.1 * w * spread.max())
        assert (np.ptp(values, axis=0) > 1.9 * w * spread).all()


def test_the_dose_is_the_share_of_linear_drivers_and_they_stay_the_same() -> None:
    some, more = linear.linear_drivers(drawn(risk=0.3)), linear.linear_drivers(drawn(risk=0.7))
    assert 5 < len(some) < len(more) < 50
    assert some.items() <= more.items()
    assert len(linear.linear_drivers(drawn(risk=1.0))) == 50
    assert linear.linear_drivers(drawn(risk=0.0)) == {}


def test_everybody_else_is_a_regular_driver_and_nothing_happens() -> None:
    """Without a dose both laws are regular traffic."""
    for task in TASKS:
        risky, regular = drawn(3, 1.0, task), drawn(3, 0.0, task)
        assert regular == drawn(3, 0.0, task, law="standard")
        assert risky.events == ()
        assert risky.vehicles == regular.vehicles
        assert risky.spawns == regular.spawns


def test_highway_env_drives_them_with_its_own_linear_vehicle() -> None:
    env: Any = make_env("highway-env", "u-turn", {"risk_law": "linear", "risk": 1.0})
    env.reset(seed=0)
    drivers = linear.linear_drivers(env.unwrapped.scenario)
    for vehicle in env.unwrapped.road.vehicles[1:]:
        assert isinstance(vehicle, LinearScenarioVehicle) and isinstance(vehicle, LinearVehicle)
        assert tuple(vehicle.ACCELERATION_PARAMETERS) == drivers[vehicle.id].acceleration
        assert tuple(vehicle.STEERING_PARAMETERS) == drivers[vehicle.id].steering
