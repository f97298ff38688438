"""Traffic that SUMO drives by its own car-following, lane-change and junction models."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sumo_env.drivers import RiskEvent
from sumo_env.loop import Progress, Traffic, native
from sumo_env.models.hazards import push_native
from sumo_env.simulation import ALL_CHECKS_OFF, NO_LANE_CHANGES, REGULAR

if TYPE_CHECKING:
    from sumo_env.world import World

CENTRED = 0.05  # [m] from the middle of a lane: no lane change is running
KEEP_DECEL_FREE = REGULAR & ~4  # speed mode: car following, but harder braking than `decel` when commanded


class Native:
    """SUMO drives; only risk events are commanded."""

    def __init__(self, speed_mode: int, lane_change_mode: int) -> None:
        self.speed_mode = speed_mode
        self.lane_change_mode = lane_change_mode
        self._modes = speed_mode, KEEP_DECEL_FREE, ALL_CHECKS_OFF  # of `push_native`
        self._forced: dict[str, float] = {}  # vehicle -> end of its cut-in [s]

    def start(self, world: World, first: int) -> None:
        if world.time == 0.0:
            self._forced.clear()

    def act(self, world: World) -> None:
        cars = world.cars
        push_native(cars.floats, cars.integers, cars.flags, self._modes, world.time, world.dt)
        world.fleet.set_speed_modes(cars.mode)
        self.end_cut_ins(world)

    def drive(self, world: World, traffic: Traffic, count: int, progress: Progress) -> Progress:
        """Up to `count` sub-steps at once (`loop`)."""
        ego = world.ego
        return native(traffic, count, self._modes, progress, ego.target_speed, ego.target_lane[2], world.dt)

    def busy_from(self, world: World) -> float:
        """Whose cut-in is over gets the lane back."""
        return min(self._forced.values(), default=math.inf)

    def end_cut_ins(self, world: World) -> None:
        """Give the lane back to the drivers whose forced change is over."""
        for name in [name for name, end in self._forced.items() if world.time >= end]:
            del self._forced[name]
            row = world.row.get(name)
            if row is not None and not world.crashed[row]:
                changes = world.specs[row].changes_lanes
                world.sim.lane_change_mode(name, self.lane_change_mode if changes else NO_LANE_CHANGES)

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        name = world.ids[row]
        lane = world.sim.lane_of(name)
        if lane.startswith(":") or abs(world.sim.lateral_position(name)) > CENTRED:
            return
        start, end, i = world.network.indices[lane]
        count = world.road.count(start, end)
        for target in (i + event.direction, i - event.direction):
            if 0 <= target < count and world.has_room(row, (start, end, target)):
                world.sim.lane_change_mode(name, NO_LANE_CHANGES)
                world.sim.change_lane(name, count - 1 - target)
                self._forced[name] = world.time + world.lane_change_duration + 0.5
                return
