"""Decisions of drivers against highway-env's, on random states of all its roads, and what they mean."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sumo_env.replica.driving import acceleration, desired_gap
from sumo_env.replica.step import act
from sumo_env.replica.tables import CAR, NONE

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


def two_cars(gap: float, speed: float, leader_speed: float) -> tuple[np.ndarray, ...]:
    """A driver with highway-env's numbers and a leader on an endless lane; arguments of `acceleration`."""
    env = environment("highway", "path")
    t = traffic(env, np.random.default_rng(0), count=2)
    cars = np.zeros(2, CAR)
    cars["x"], cars["speed"], cars["cos"] = (100.0, 100.0 + gap), (speed, leader_speed), 1.0
    cars["target_speed"], cars["lane"] = 22.5, 0
    cars["accel"], cars["decel"], cars["jam_distance"], cars["tau"], cars["delta"] = 3.0, 5.0, 10.0, 1.5, 4.0
    t.places.s[0] = cars["x"]
    return t.table, cars, t.places, t.rules


def test_a_steady_speed_keeps_a_steady_distance() -> None:
    """36.28 m between centres at 15 m/s and a desired speed of 22.5 m/s (measured in highway-env)."""
    gap = (10 + 1.5 * 15) / math.sqrt(1 - (15 / 22.5) ** 4)
    assert gap == pytest.approx(36.28, abs=0.01)
    table, cars, places, rules = two_cars(gap, 15.0, 15.0)
    assert desired_gap(cars[0], 15.0, 0.0) == pytest.approx(32.5)
    assert acceleration(table, cars, places, rules, cars[0], 0, 1) == pytest.approx(0.0, abs=1e-9)


def test_a_leader_that_drives_away_fast_makes_its_follower_brake() -> None:
    """The desired gap has no lower bound: it is negative here, and counts squared."""
    table, cars, places, rules = two_cars(12.0, 10.0, 40.0)
    alone = acceleration(table, cars, places, rules, cars[0], 0, NONE)
    assert acceleration(table, cars, places, rules, cars[0], 0, 1) < alone


def test_nobody_follows_nobody() -> None:
    table, cars, places, rules = two_cars(12.0, 10.0, 10.0)
    assert acceleration(table, cars, places, rules, cars[0], NONE, 1) == 0.0
