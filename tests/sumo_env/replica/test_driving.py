"""Decisions of drivers against highway-env's, on random states of all its roads."""

from __future__ import annotations

import numpy as np
import pytest

from sumo_env.replica.step import act
from sumo_env.replica.tables import NONE

from .stock import TASKS, VARIANTS, close, environment, traffic


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("task", TASKS)
def test_everybody_acts_as_in_highway_env(task: str, variant: str) -> None:
    """The next lane of the route, MOBIL, giving up, forced changes, timers, steering and acceleration."""
    env = environment(task, variant)
    rng = np.random.default_rng(4)
    changed = given_up = moved_on = 0
    for _ in range(60):
        t = traffic(env, rng, count=25 if task == "highway" else 14)
        before = t.cars.copy()
        act(t.table, t.cars, t.places, t.rules)
        t.road.act()
        for was, car, vehicle in zip(before, t.cars, t.road.vehicles, strict=True):
            assert t.lanes.names[car["target"]] == vehicle.target_lane_index
            if vehicle.crashed:
                continue  # its action is overwritten in the step
            close(car["acceleration"], vehicle.action["acceleration"])
            close(car["steering"], vehicle.action["steering"])
            assert car["timer"] == getattr(vehicle, "timer", 0.0)
            route = vehicle.route or []
            left = [k for k in car["route"][car["leg"] :] if k != NONE]
            assert left == [t.lanes.numbers[start, end, 0] for start, end, _ in route]
            assert car["planned"] == (route[0][2] if route and route[0][2] is not None else NONE)
            if t.table["road"][was["target"]] != t.table["road"][car["target"]]:
                moved_on += 1
            elif was["target"] != car["target"]:
                changed += was["lane"] == was["target"]
                given_up += car["lane"] == car["target"]
    assert changed >= {"highway": 40, "roundabout": 2, "u-turn": 5}.get(task, 0)
    assert given_up >= {"highway": 5}.get(task, 0)
    assert moved_on >= {"highway": 0, "two-way": 0}.get(task, 20)
