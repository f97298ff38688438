"""Traffic that is driven by highway-env's rules (`models`): their accelerations are commanded to SUMO as speeds.

SUMO's own IDM is another formula (it does not brake behind a leader that drives away, and counts gaps between
bumpers): in stop-and-go traffic its speeds are 1.6 m/s from highway-env's, these 0.05 (docs/decisions.md).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sumo_env.drivers import RiskEvent
from sumo_env.loop import Progress, Traffic, straight, strip
from sumo_env.models.hazards import push
from sumo_env.models.idm import act_on_strip
from sumo_env.models.mobil import act, closest_lanes
from sumo_env.models.motion import euler
from sumo_env.native import CENTRED
from sumo_env.simulation import ALL_CHECKS_OFF, NO_LANE_CHANGES

if TYPE_CHECKING:
    from sumo_env.world import World

LANE_WIDTH = 4.0  # [m]
SWERVE_TIME = 3.0  # [s] that a cut-in on the two-way road stays in the oncoming lane


class Computed:
    """Speeds by highway-env's formulas, applied with `setSpeed`; base of the two rules that do so."""

    speed_mode = ALL_CHECKS_OFF
    lane_change_mode = NO_LANE_CHANGES
    steers = True  # cars move sideways by highway-env's steering for target lanes, not by SUMO's lane changes

    def start(self, world: World, first: int) -> None:
        raise NotImplementedError

    def accelerate(self, world: World) -> None:
        """Write what the drivers want into ``world.cars.acceleration``, and the lanes they steer for into `target`."""
        raise NotImplementedError

    def drive(self, world: World, traffic: Traffic, count: int, progress: Progress) -> Progress:
        """Up to `count` sub-steps at once (`loop`)."""
        raise NotImplementedError

    def busy_from(self, world: World) -> float:
        """Braking and surging are compiled as well."""
        return math.inf

    def act(self, world: World) -> None:
        self.accelerate(world)
        push(world.cars.floats, world.cars.flags, world.time, world.dt)


class Mobil(Computed):
    """highway-env's IDM and MOBIL on the straight highway (`models.idm`, `models.mobil`)."""

    def start(self, world: World, first: int) -> None:
        cars = world.cars
        self._lanes = int(world.config["lanes_count"])
        cars.target[:] = closest_lanes(world.y, self._lanes, LANE_WIDTH)
        cars.timer[:] = [spec.timer for spec in world.specs]
        cars.changes[:] = [spec.changes_lanes for spec in world.specs]
        cars.changes[0] = False

    def accelerate(self, world: World) -> None:
        cars = world.cars
        act(
            cars.floats, cars.integers, cars.flags, world.drivers, self._lanes, LANE_WIDTH, world.road_length,
            world.limit, world.dt,
        )  # fmt: skip

    def drive(self, world: World, traffic: Traffic, count: int, progress: Progress) -> Progress:
        return straight(
            traffic, count, self._lanes, LANE_WIDTH, world.road_length, world.limit, progress, world.ego.target_speed,
            world.dt,
        )  # fmt: skip

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        cars = world.cars
        lane = int(cars.target[row])
        for target in (lane + event.direction, lane - event.direction):
            if 0 <= target < self._lanes and world.has_room(row, ("0", "1", target)):
                cars.target[row], cars.forced[row] = target, True
                return


class Strip(Computed):
    """highway-env's IDM on the two-way road: it brakes for oncoming cars and above its desired speed as there."""

    steers = False  # SUMO's opposite lanes know no position between the lanes

    def start(self, world: World, first: int) -> None:
        lane_y = np.where(world.y < LANE_WIDTH / 2, 0.0, LANE_WIDTH)
        direction = [1.0 if spec.lane[0] == "a" else -1.0 for spec in world.specs]
        self._sides = np.array([lane_y, lane_y, direction])
        _, self._target_y, self._direction = self._sides
        self._return: dict[int, float] = {}  # row -> from when on it changes back [s]

    def accelerate(self, world: World) -> None:
        for row in [row for row, time in self._return.items() if world.time >= time]:
            if world.crashed[row]:
                del self._return[row]
            elif abs(world.y[row]) < CENTRED:
                del self._return[row]
                self._target_y[row] = LANE_WIDTH
                world.sim.change_lane_relative(world.ids[row], -1)
        act_on_strip(world.cars.floats, self._sides, world.drivers, world.road_length, world.limit)

    def act(self, world: World) -> None:
        super().act(world)
        cars = world.cars
        euler(cars.speed, cars.acceleration, cars.crashed, world.dt, 0.0, cars.own_speed, cars.distance)

    def drive(self, world: World, traffic: Traffic, count: int, progress: Progress) -> Progress:
        ego = world.ego
        return strip(
            traffic, count, self._sides, world.road_length, world.limit, progress, ego.target_speed,
            ego.target_lane[2], world.dt,
        )  # fmt: skip

    def busy_from(self, world: World) -> float:
        """Who cut in has to be told to change back."""
        return min(self._return.values(), default=math.inf)

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        on_lane = self._direction[row] > 0 and abs(world.y[row] - LANE_WIDTH) < CENTRED
        if on_lane and world.has_room(row, ("a", "b", 0)):
            self._target_y[row] = 0.0
            world.sim.change_lane_relative(world.ids[row], 1)
            self._return[row] = world.time + SWERVE_TIME
