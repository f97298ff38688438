"""Copies for planners that do not know what drivers are like."""

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from highway_env.vehicle.behavior import LinearVehicle

from experiments.backends import make_env
from sumo_env.replica import linear
from sumo_env.replica.draws import with_other_drivers
from sumo_env.replica.tables import PARAMETERS
from sumo_env.tasks import TASKS
from sumo_env.traffic.scenario import Scenario
from tests.tasks import highway_env_task

RISKY = {"scenarios": "seeded", "config": {"risk": 0.6}}
LINEAR = {**RISKY, "risk_law": "linear"}
ARRIVING = {"intersection": {"config": {"spawn_probability": 1.0}}}


def started(task: str, **choices: Any) -> Any:
    env = gym.make(f"replica/{task}-v0", **choices).unwrapped
    env.reset(seed=1)
    env.step(1)
    return env


def scenes(env: Any, steps: int = 4) -> bytes:
    """The places of all vehicles in some steps."""
    return b"".join((env.step(1), env.scene.x.tobytes())[1] for _ in range(steps))


@pytest.mark.parametrize("choices", [RISKY, LINEAR], ids=["standard", "linear"])
@highway_env_task
def test_an_imagined_copy_has_the_past_and_another_future(task: str, choices: dict[str, Any]) -> None:
    env = started(task, **choices)
    known, once, again, otherwise = copy.deepcopy(env), env.imagine(1), env.imagine(1), env.imagine(2)
    for twin in (once, otherwise):
        np.testing.assert_array_equal(twin.scene.x, env.scene.x)
        np.testing.assert_array_equal(twin.replica._cars["x"], env.replica._cars["x"])
    future = scenes(env)
    assert scenes(known) == future
    first = scenes(once)
    assert first == scenes(again) and first != future and first != scenes(otherwise)


@pytest.mark.parametrize("task", ["highway", "roundabout", "intersection", "u-turn"])
def test_of_highway_env_s_drivers_the_exponent_is_drawn(task: str) -> None:
    """But of those whose exponent highway-env does not draw, and of the ego; who arrives is no other copy's."""
    env = started(task, **ARRIVING.get(task, {}))
    twin = env.imagine(3)
    ours, theirs = env.replica._cars, twin.replica._cars
    changed = [name for name in PARAMETERS if not np.array_equal(ours[name], theirs[name])]
    assert changed == ["delta"]
    assert ((theirs["delta"][1:] >= 3.5) & (theirs["delta"][1:] <= 4.5)).all()
    assert (theirs["delta"] == ours["delta"]).tolist() == (ours["delta"] == 4.0).tolist()
    scenes(twin)
    assert scenes(env) == scenes(started(task, **ARRIVING.get(task, {})))


def test_drivers_come_from_the_pool_of_their_dose() -> None:
    scenario = started("intersection", **RISKY).scenario
    other = with_other_drivers(scenario, 5)
    same, kept = ([v._replace(driver=None) for v in one.vehicles] for one in (other, scenario))
    assert same == kept
    kinds = {driver.type[0] for pool in scenario.pools for driver in pool.drivers}
    assert kinds == {"d", "f"}
    everybody = ([*one.vehicles, *(spawn.vehicle for spawn in one.spawns)] for one in (scenario, other))
    drivers = [(before.driver, after.driver) for before, after in zip(*everybody, strict=True)]
    assert sum(old != new for old, new in drivers) > len(drivers) / 2
    for old, new in drivers:
        assert (old.type[0], old.type.partition("@")[2]) == (new.type[0], new.type.partition("@")[2])


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
    every = np.array([(*driver.acceleration, *driver.steering) for driver in drivers])
    assert abs(np.corrcoef(every.T) - np.eye(5)).max() < 0.15  # all are drawn independently


def test_the_dose_is_the_share_of_linear_drivers_and_they_stay_the_same() -> None:
    some, more = linear.linear_drivers(drawn(risk=0.3)), linear.linear_drivers(drawn(risk=0.7))
    assert 5 < len(some) < len(more) < 50
    assert some.items() <= more.items()
    assert len(linear.linear_drivers(drawn(risk=1.0))) == 50
    assert linear.linear_drivers(drawn(risk=0.0)) == {}
    assert linear.linear_drivers(with_other_drivers(drawn(), 5)) != linear.linear_drivers(drawn())


def test_everybody_else_is_a_regular_driver_and_nothing_happens() -> None:
    """Without a dose both laws are regular traffic."""
    for task in TASKS:
        risky, regular = drawn(3, 1.0, task), drawn(3, 0.0, task)
        assert regular == drawn(3, 0.0, task, law="standard")
        assert risky.events == ()
        assert risky.vehicles == regular.vehicles
        assert risky.spawns == regular.spawns
