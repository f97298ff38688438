"""Scenarios for tests: drawn as an environment draws them, then changed by hand."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from sumo_env.config import resolve
from sumo_env.networks.roads import LaneIndex
from sumo_env.tasks import get_task
from sumo_env.tasks.base import make_on_lane
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.scenario import Scenario, VehicleSpec


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


def placed(
    scenario: Scenario, number: int, lane: LaneIndex, s: float, speed: float, **more: Any
) -> VehicleSpec:
    """A vehicle of a scenario elsewhere: `s` [m] along a lane, with this speed [m/s]; more: as of `make_on_lane`."""
    spec = scenario.vehicles[number]
    place = scenario.road, spec.id, lane, s, speed
    return make_on_lane(*place, spec.driver, destination=spec.destination, **more)


def with_leader(distance: float, speed: float) -> Callable[[Scenario], Scenario]:
    """Only one vehicle besides the ego: `distance` [m] ahead of it in its lane (behind it if negative)."""

    def change(scenario: Scenario) -> Scenario:
        leader = placed(scenario, 0, scenario.ego.lane, scenario.ego.s + distance, speed)
        return replace(scenario, vehicles=(leader,), spawns=(), events=())

    return change
