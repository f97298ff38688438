"""Scenarios for tests: drawn as an environment draws them, then changed by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from sumo_env.config import resolve
from sumo_env.tasks import get_task
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.scenario import Scenario


def draw(task: str, seed: int = 0, **config: Any) -> Scenario:
    """The scenario that an environment of this configuration draws from a seed of the traffic."""
    the_task = get_task(task)
    return the_task.scenario(resolve(task, the_task.defaults, config), seed)


def drivers(task: str, dose: float) -> list[Driver]:
    """Every driver that may occur in a scenario of this dose."""
    return [driver for pool in get_task(task).pools(dose) for driver in pool.drivers]


def alone(scenario: Scenario) -> Scenario:
    """The ego on an empty road."""
    return replace(scenario, vehicles=(), spawns=(), events=())


def with_leader(distance: float, speed: float) -> Callable[[Scenario], Scenario]:
    """Only one vehicle besides the ego: `distance` [m] ahead of it in its lane (behind it if negative)."""

    def change(scenario: Scenario) -> Scenario:
        ego, other = scenario.ego, scenario.vehicles[0]
        leader = other._replace(
            lane=ego.lane,
            s=ego.s + distance,
            x=ego.x + distance,
            y=ego.y,
            heading=ego.heading,
            speed=speed,
            target_speed=speed,
        )
        return replace(scenario, vehicles=(leader,), spawns=(), events=())

    return change
