"""Copies for planners that do not know what drivers are like."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.replica.draws import with_other_drivers
from sumo_env.replica.tables import PARAMETERS
from tests.tasks import highway_env_task

RISKY = {"scenarios": "seeded", "config": {"risk": 0.6}}
LINEAR = {**RISKY, "risk_law": "linear"}


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


@pytest.mark.parametrize("task", ["highway", "roundabout", "intersection"])
def test_of_highway_env_s_drivers_the_exponent_is_drawn(task: str) -> None:
    env = started(task)
    twin = env.imagine(3)
    ours, theirs = env.replica._cars, twin.replica._cars
    changed = [name for name in PARAMETERS if not np.array_equal(ours[name], theirs[name])]
    assert changed == ["delta"]
    assert ((theirs["delta"][1:] >= 3.5) & (theirs["delta"][1:] <= 4.5)).all()
    assert theirs["delta"][0] == ours["delta"][0]  # the ego's


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
