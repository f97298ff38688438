"""When SUMO has to look for contacts: before its step, for what may be after it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sumo_env.cars import Cars
from sumo_env.collision import NEAR
from sumo_env.env import DrivingEnv
from sumo_env.models.dangers import anybody_near, may_touch
from sumo_env.world import World


def two(x: float, y: float, heading: float = 0.0, speed: float = 20.0) -> Cars:
    """The ego at the origin at 20 m/s, and another car."""
    cars = Cars(2)
    cars.x[1], cars.y[1], cars.heading[1] = x, y, heading
    cars.speed[:] = 20.0, speed
    return cars


@pytest.mark.parametrize(
    ("cars", "expected"),
    [
        (two(0.0, 4.0), False),  # side by side in the middle of neighbouring lanes
        (two(0.0, 3.5), True),  # one of them changes lane
        (two(20.0, 0.0), False),
        (two(6.5, 0.0), True),
        (two(8.0, 0.0, speed=5.0), True),  # 1.5 m apart after the step
        (two(8.5, 0.0, speed=20.0), False),
        (two(10.0, 0.0, np.pi), True),  # oncoming
        (two(30.0, 0.0, np.pi), False),
        (two(6.0, 6.0, -np.pi / 2), True),  # crossing
    ],
)
def test_cars_may_touch_that_are_near_after_a_step_straight_on(cars: Cars, expected: bool) -> None:
    assert may_touch(cars.floats, cars.flags, 0.1) == expected


def test_a_wrecked_ego_and_a_long_step_have_sumo_look() -> None:
    cars = two(100.0, 0.0)
    assert may_touch(cars.floats, cars.flags, 0.2)
    cars.crashed[1] = True
    assert not may_touch(cars.floats, cars.flags, 0.1)
    cars.crashed[0] = True
    assert may_touch(cars.floats, cars.flags, 0.1)


@pytest.mark.parametrize(("task", "traffic_model"), [("highway", "sumo"), ("two-way", "matched")])
def test_nobody_is_near_after_a_step_in_which_nobody_may_touch(
    task: str, traffic_model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreseen = {True: 0, False: 0}
    step = World._substep

    def watched(world: World) -> int:
        cars = world.cars
        expected = may_touch(cars.floats, cars.flags, world.dt)
        step(world)
        assert expected or not anybody_near(world.x, world.y, world.heading, NEAR)
        foreseen[expected] += 1
        return 1

    monkeypatch.setattr(World, "_substep", watched)
    monkeypatch.setattr(World, "_undisturbed", lambda world, most: 0)
    env: Any = DrivingEnv(task, {"traffic_model": traffic_model, "risk": 1.0})
    for seed in range(10):
        env.reset(seed=seed)
        actions = np.random.default_rng(seed)
        while not any(env.step(int(actions.integers(env.action_space.n)))[2:4]):
            pass
    env.close()
    assert min(foreseen.values()) > 50
