"""Ways and speeds of highway-env's Euler steps at any length of step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from sumo_env.cars import Cars
from sumo_env.models.motion import euler, keep_to_lanes

REFERENCE = 1.0 / 15.0


def moved(speed: float, acceleration: float, dt: float, least: float = 0.0) -> tuple[float, float]:
    """The way [m] of one vehicle and its speed after the step [m/s]."""
    own, distance = np.full(2, np.nan), np.full(2, np.nan)
    euler(
        np.array([0.0, speed]), np.array([0.0, acceleration]), np.zeros(2, np.bool_), dt, least, own, distance
    )
    assert np.isnan(distance[0]) and np.isnan(own[0])  # the ego
    return float(distance[1]), float(own[1])


@pytest.mark.parametrize("steps", [1, 3])
def test_distance_and_speed_are_those_of_euler_steps(steps: int) -> None:
    speed, expected = 20.0, 0.0
    for _ in range(steps):
        expected += speed * REFERENCE  # explicit: highway-env moves before it accelerates
        speed -= 3.0 * REFERENCE
    distance, own = moved(20.0, -3.0, steps * REFERENCE)
    assert distance == pytest.approx(expected)
    assert own == pytest.approx(speed)


def test_nobody_drives_backwards_unless_allowed() -> None:
    assert moved(0.1, -9.0, 0.1) == (0.0, 0.0)
    distance, own = moved(0.1, -9.0, 0.1, -math.inf)
    assert distance < 0.0 and own == pytest.approx(-0.8)


def test_wrecks_are_not_moved() -> None:
    own, distance = np.full(2, np.nan), np.full(2, np.nan)
    euler(np.ones(2), np.ones(2), np.array([False, True]), 0.1, 0.0, own, distance)
    assert np.isnan(distance[1]) and np.isnan(own[1])


def test_speeds_are_told_to_those_whose_way_is_known() -> None:
    cars = Cars(4)
    cars.speed[:] = 20.0
    cars.distance[:] = 2.0, 1.0, np.nan, np.nan
    cars.crashed[3] = True
    cars.lane[:] = 1
    cars.command[2] = -1.0
    stretch = np.array([[1.0, 1.1], [1.0, 1.2]])  # of the ego and of the others
    keep_to_lanes(cars.floats, cars.integers, cars.flags, stretch, 0.1)
    assert cars.command[:2] == pytest.approx([2.0 / 0.1 * 1.1, 1.0 / 0.1 * 1.2])
    assert cars.command[2] == -1.0 and np.isnan(cars.own_speed[:3]).all()  # SUMO drives
    assert cars.own_speed[3] == pytest.approx(20.0 * (14 / 15) ** 1.5)  # a wreck: explicit Euler at 15 Hz
    way = 20.0 - cars.own_speed[3]  # what it loses, by a = -v
    assert cars.command[3] == pytest.approx(way / 0.1 * 1.2)


def test_a_wrecked_ego_is_told_the_way_that_it_coasts() -> None:
    cars = Cars(2)
    cars.crashed[:] = True
    cars.distance[0] = 1.5
    keep_to_lanes(cars.floats, cars.integers, cars.flags, np.ones((2, 1)), 0.1)
    assert cars.command.tolist() == [1.5 / 0.1, 0.0] and np.isnan(cars.own_speed[0])
