"""The second law of risk, ``risk_law="linear"``: the treatment of the paper, among highway-env's physics.

The paper draws parameters of acceleration and steering, ``p = p_min + U(0, 1) * (p_max - p_min)``; its code is not
public, and in highway-env these two equations are ``LinearVehicle.randomize_behavior``. A risky driver here is a
LinearVehicle with parameters drawn from highway-env's ranges made WIDENING times as wide. The share of such drivers is
the dose, and a driver who is risky at one dose is the same at a higher one; everybody else is a regular driver, and no
risk events happen.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sumo_env.config import Config
from sumo_env.streams import stream
from sumo_env.tasks.base import Task
from sumo_env.traffic.scenario import Scenario

LAWS = ("standard", "linear")
WIDENING = 2.0  # to the widest that leaves all parameters positive
# Of highway-env's LinearVehicle: gains of the difference to the desired speed [1/s], of that to a slower leader's speed
# [1/s], and of what is missing to the safe distance [1/s2]; half the range as a share of the gain.
ACCELERATION, ACCELERATION_SPREAD = np.array([0.3, 0.3, 2.0]), 0.5
# Gains of the heading [1/s] and of the lateral position [1/s2]; half the range.
STEERING, STEERING_SPREAD = np.array([1 / 0.2, 1 / 0.2 / 0.6]), np.array([0.07, 1.5])
TIME_WANTED = 2.5  # [s] of a LinearVehicle


class LinearDriver(NamedTuple):
    """Parameters of a LinearVehicle: ACCELERATION_PARAMETERS and STEERING_PARAMETERS."""

    acceleration: tuple[float, float, float]
    steering: tuple[float, float]


def linear_drivers(scenario: Scenario) -> dict[str, LinearDriver]:
    """The risky drivers of a scenario by the id of their vehicle; a function of its seed, vehicles and dose."""
    rng = stream(scenario.seed, "linear drivers")
    found: dict[str, LinearDriver] = {}
    for spec in scenario.everybody[1:]:
        if spec.is_obstacle:
            continue
        share, *draws = rng.uniform(size=1 + len(ACCELERATION) + len(STEERING))
        if share < scenario.risk:
            where = 2.0 * np.array(draws) - 1.0  # in the range, from -1 to 1
            acceleration = ACCELERATION * (1.0 + WIDENING * ACCELERATION_SPREAD * where[:3])
            steering = STEERING + WIDENING * STEERING_SPREAD * where[3:]
            found[spec.id] = LinearDriver(tuple(acceleration.tolist()), tuple(steering.tolist()))
    return found


def draw(task: Task, config: Config, seed: int) -> Scenario:
    """The scenario of a seed in which only `linear_drivers` are risky."""
    return replace(task.scenario({**config, "risk": 0.0}, seed), risk=config["risk"])
