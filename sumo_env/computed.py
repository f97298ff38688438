"""Traffic that is driven by highway-env's rules (`models`): their accelerations are commanded to SUMO as speeds.

SUMO's own IDM is another formula (it does not brake behind a leader that drives away, and counts gaps between
bumpers): in stop-and-go traffic its speeds are 1.6 m/s from highway-env's, these 0.05 (docs/decisions.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sumo_env.drivers import RiskEvent
from sumo_env.models.idm import strip_accelerations
from sumo_env.models.mobil import closest_lanes, drive
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
    steers = True  # cars move sideways by highway-env's steering toward `targets`, not by SUMO's lane changes

    def targets(self, world: World) -> NDArray[np.int64]:
        """Number of the lane that every vehicle but the ego steers for, shape (n,)."""
        raise NotImplementedError

    def accelerations(self, world: World) -> NDArray[np.float64]:
        raise NotImplementedError

    def act(self, world: World) -> None:
        world.accelerate(world.push(self.accelerations(world)))


class Mobil(Computed):
    """highway-env's IDM and MOBIL on the straight highway (`models.idm`, `models.mobil`)."""

    def start(self, world: World) -> None:
        self._lanes = int(world.config["lanes_count"])
        self._target = closest_lanes(world.y, self._lanes, LANE_WIDTH)
        self._timer = np.array([spec.timer for spec in world.specs])
        self._changes = np.array([spec.changes_lanes for spec in world.specs])
        self._changes[0] = False
        self._forced = np.zeros(len(world.ids), np.bool_)
        self._acceleration = np.empty(len(world.ids))

    def accelerations(self, world: World) -> NDArray[np.float64]:
        self._target[0] = world.ego.target_lane[2]
        drive(
            world.x, world.y, world.speed, world.heading, world.crashed, world.target_speed, world.drivers,
            self._target, self._timer, self._changes, self._forced, self._lanes, LANE_WIDTH, world.road_length,
            world.limit, world.dt, self._acceleration,
        )  # fmt: skip
        return self._acceleration

    def targets(self, world: World) -> NDArray[np.int64]:
        return self._target

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        lane = int(self._target[row])
        for target in (lane + event.direction, lane - event.direction):
            if 0 <= target < self._lanes and world.has_room(row, ("0", "1", target)):
                self._target[row] = target
                self._forced[row] = True
                return


class Strip(Computed):
    """highway-env's IDM on the two-way road: it brakes for oncoming cars and above its desired speed as there."""

    steers = False  # SUMO's opposite lanes know no position between the lanes

    def start(self, world: World) -> None:
        self._direction = np.array([1.0 if spec.lane[0] == "a" else -1.0 for spec in world.specs])
        self._lane_y = np.where(world.y < LANE_WIDTH / 2, 0.0, LANE_WIDTH)
        self._target_y = self._lane_y.copy()
        self._return: dict[int, float] = {}

    def accelerations(self, world: World) -> NDArray[np.float64]:
        np.multiply(world.y >= LANE_WIDTH / 2, LANE_WIDTH, out=self._lane_y)
        returning = [row for row, time in self._return.items() if world.time >= time] if self._return else ()
        for row in returning:
            if world.crashed[row]:
                del self._return[row]
            elif self._lane_y[row] == 0.0 and abs(world.y[row]) < CENTRED:
                del self._return[row]
                self._target_y[row] = LANE_WIDTH
                world.sim.change_lane_relative(world.ids[row], -1)
        return strip_accelerations(
            world.x, world.y, world.speed, world.heading, self._lane_y, self._target_y, self._direction,
            world.target_speed, world.drivers, world.road_length, world.limit,
        )  # fmt: skip

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        on_lane = self._direction[row] > 0 and abs(world.y[row] - LANE_WIDTH) < CENTRED
        if on_lane and world.has_room(row, ("a", "b", 0)):
            self._target_y[row] = 0.0
            world.sim.change_lane_relative(world.ids[row], 1)
            self._return[row] = world.time + SWERVE_TIME
