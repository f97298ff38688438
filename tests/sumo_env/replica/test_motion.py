"""Motion and contacts against highway-env's ``Road.step``."""

from __future__ import annotations

import numpy as np
import pytest
from highway_env.utils import are_polygons_intersecting

from sumo_env.replica.contacts import touch
from sumo_env.replica.numpy_loops import LOOPS, binary, unary
from sumo_env.replica.step import step

from .stock import TASKS, close, environment, records, traffic


@pytest.mark.parametrize("task", TASKS)
def test_a_sub_step_is_that_of_highway_env(task: str) -> None:
    """Poses, speeds, lanes, right of way, contacts and what follows from them, of vehicles in each other's way."""
    env = environment(task, "path")
    rng = np.random.default_rng(5)
    crashes = pushed = 0
    for _ in range(40):
        t = traffic(env, rng, count=20)
        for car, vehicle in zip(t.cars, t.road.vehicles, strict=True):
            vehicle.action = {"steering": rng.uniform(-1.0, 1.0), "acceleration": rng.uniform(-9.0, 9.0)}
            car["steering"], car["acceleration"] = vehicle.action["steering"], vehicle.action["acceleration"]
        if t.rules.regulation_interval:
            t.road.respect_priorities = env.road.respect_priorities
        for count in range(6, 9):  # the right of way is looked at in the seventh
            t.road.steps = count - 1
            step(t.table, t.cars, t.places, t.rules, count)
            t.road.step(t.rules.dt)
        for car, theirs, vehicle in zip(t.cars, records(t.road, t.lanes), t.road.vehicles, strict=True):
            for name in ("x", "y", "heading", "cos", "sin", "speed", "target_speed", "apart_x", "apart_y"):
                close(car[name] if name[:5] != "apart" or car["is_pushed_apart"] else 0.0, theirs[name])
            for name in ("lane", "crashed", "is_pushed_apart", "yields"):
                assert car[name] == theirs[name]
            crashes += vehicle.crashed
            pushed += vehicle.impact is not None
    assert crashes > 80 and pushed > 5


def test_contacts_are_highway_env_s_at_any_angle() -> None:
    env = environment("highway", "path")
    rng = np.random.default_rng(6)
    counts = np.zeros(2, int)
    for _ in range(300):
        t = traffic(env, rng, count=2)
        first, second = t.road.vehicles
        second.position = first.position + rng.normal(size=2) * 3.0
        first.heading, second.heading = rng.uniform(-4.0, 4.0, 2)
        a, b = records(t.road, t.lanes)
        now, soon, x, y = touch(a, b, 1 / 15)
        theirs = are_polygons_intersecting(
            first.polygon(), second.polygon(), first.velocity / 15, second.velocity / 15
        )
        assert (now, soon) == theirs[:2]
        if soon:
            close((x, y), theirs[2])
        counts += now, soon
    assert (counts > 50).all() and (counts < 280).all()


def test_functions_round_as_numpy_does_on_this_processor() -> None:
    rng = np.random.default_rng(7)
    for x, y in zip(rng.uniform(-1.0, 1.0, 2000), rng.uniform(3.5, 4.5, 2000), strict=True):
        assert unary(LOOPS.tan, x) == np.tan(x)
        assert unary(LOOPS.arcsin, x) == np.arcsin(x)
        assert unary(LOOPS.arctan, x) == np.arctan(x)
        assert binary(LOOPS.arctan2, x, y) == np.arctan2(x, y)
        assert binary(LOOPS.power, abs(x), y) == np.power(abs(x), y)
    assert unary(LOOPS.arcsin, 0.0) == 0.0
