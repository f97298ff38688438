"""Speeds commanded for highway-env's Euler steps."""

from __future__ import annotations

import numpy as np
import pytest

from sumo_env.models.motion import command_euler

REFERENCE = 1.0 / 15.0


def commanded(speed: float, acceleration: float, dt: float, stretch: float = 1.0) -> tuple[float, float]:
    """The command to one vehicle and its own speed after the step."""
    own, command = np.full(2, np.nan), np.empty(2)
    command_euler(
        np.array([0.0, speed]), np.array([0.0, acceleration]), np.zeros(2, np.bool_), dt,
        np.array([0, 1]), np.array([9.0, stretch]), stretch != 1.0, own, command,
    )  # fmt: skip
    assert np.isnan(command[0]) and np.isnan(own[0])  # the ego
    return float(command[1]), float(own[1])


@pytest.mark.parametrize("steps", [1, 3])
def test_distance_and_speed_are_those_of_euler_steps(steps: int) -> None:
    dt = steps * REFERENCE
    speed, distance = 20.0, 0.0
    for _ in range(steps):
        distance += speed * REFERENCE  # explicit: highway-env moves before it accelerates
        speed -= 3.0 * REFERENCE
    command, own = commanded(20.0, -3.0, dt)
    assert command * dt == pytest.approx(distance)
    assert own == pytest.approx(speed)


def test_nobody_drives_backwards() -> None:
    assert commanded(0.1, -9.0, 0.1) == (0.0, 0.0)


def test_bends_stretch_the_command_but_not_the_speed() -> None:
    command, own = commanded(10.0, 0.0, 0.1, stretch=1.1)
    assert command == pytest.approx(11.0) and own == 10.0


def test_wrecks_are_not_commanded() -> None:
    own, command = np.full(2, np.nan), np.empty(2)
    command_euler(
        np.ones(2),
        np.ones(2),
        np.array([False, True]),
        0.1,
        np.zeros(2, np.int64),
        np.ones(1),
        False,
        own,
        command,
    )
    assert np.isnan(command[1]) and np.isnan(own[1])
