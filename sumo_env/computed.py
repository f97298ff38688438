"""Traffic that is driven by highway-env's rules (`models`): their accelerations are commanded to SUMO as speeds.

SUMO's own IDM is another formula (it does not brake behind a leader that drives away, and counts gaps between
bumpers): in stop-and-go traffic its speeds are 1.6 m/s from highway-env's, these 0.05 (docs/decisions.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from sumo_env.drivers import RiskEvent
from sumo_env.models.give_way import PERIOD, regulate
from sumo_env.models.idm import path_accelerations, strip_accelerations
from sumo_env.models.lane_table import advance, first_elsewhere
from sumo_env.models.mobil import closest_lanes, drive
from sumo_env.native import CENTRED, Native
from sumo_env.simulation import ALL_CHECKS_OFF, NO_LANE_CHANGES
from sumo_env.tasks.intersection import REGULATION_INTERVAL, WARM_UP, WARM_UP_FREQUENCY, compiled_lanes, path

if TYPE_CHECKING:
    from sumo_env.world import World

LANE_WIDTH = 4.0  # [m]
SWERVE_TIME = 3.0  # [s] that a cut-in on the two-way road stays in the oncoming lane
LONGEST_WAY = 14  # lanes: an entry, its curve, once around the ring, an exit


class Computed:
    """Speeds by highway-env's formulas, applied with `setSpeed`; base of the two rules that do so."""

    speed_mode = ALL_CHECKS_OFF
    lane_change_mode = NO_LANE_CHANGES

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
        self._moving = np.empty(len(world.ids), np.int64)

    def accelerations(self, world: World) -> NDArray[np.float64]:
        """Also commands the lane changes that begin now."""
        self._target[0] = world.ego.target_lane[2]
        count = drive(
            world.x, world.y, world.speed, world.heading, world.crashed, world.target_speed, world.drivers,
            self._target, self._timer, self._changes, self._forced, self._lanes, LANE_WIDTH, world.road_length,
            world.limit, world.dt, CENTRED, self._acceleration, self._moving,
        )  # fmt: skip
        for row in self._moving[:count].tolist():
            world.sim.change_lane(world.ids[row], self._lanes - 1 - int(self._target[row]))
        return self._acceleration

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        lane = int(self._target[row])
        for target in (lane + event.direction, lane - event.direction):
            if 0 <= target < self._lanes and world.has_room(row, ("0", "1", target)):
                self._target[row] = target
                self._forced[row] = True
                return


class Strip(Computed):
    """highway-env's IDM on the two-way road: it brakes for oncoming cars and above its desired speed as there."""

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


class AlongPath(Computed):
    """highway-env's IDM along the path on a road of bends and joins; lane changes are SUMO's, or none."""

    def __init__(self, lane_change_mode: int) -> None:
        self.lane_change_mode = lane_change_mode
        self._lanes = Native(self.speed_mode, lane_change_mode)

    def start(self, world: World) -> None:
        self._lanes.start(world)
        self._table = compiled_lanes(world.road)
        self._lane = [spec.lane for spec in world.specs]
        indices = [world.network.indices.get(lane) for lane in world.sim.lane_ids]
        self._number = np.array([-1 if index is None else self._table.index[index] for index in indices])
        self._on = np.array([self._table.index[lane] for lane in self._lane])
        self._routes = np.array([self._route(world, row) for row in range(len(world.specs))])
        self._stage = np.zeros(len(world.specs), np.int64)

    def _route(self, world: World, row: int) -> NDArray[np.int64]:
        """The way of a vehicle from its present lane on, as a row of `routes`."""
        lanes = world.road.way(self._lane[row], world.specs[row].destination)
        return self._table.route(lanes, LONGEST_WAY)

    def act(self, world: World) -> None:
        self._lanes.end_cut_ins(world)
        self._see_lane_changes(world)
        super().act(world)

    def _see_lane_changes(self, world: World) -> None:
        while (row := first_elsewhere(self._number, world.lane, self._on)) >= 0:
            now = world.network.indices[world.sim.lane_ids[world.lane[row]]]
            changed = now[:2] == self._lane[row][:2]
            self._lane[row], self._on[row] = now, self._number[world.lane[row]]
            if changed:
                self._routes[row], self._stage[row] = self._route(world, row), 0

    def accelerations(self, world: World) -> NDArray[np.float64]:
        geometry = self._table.geometry
        advance(geometry, self._routes, self._stage, world.x, world.y)
        return path_accelerations(
            geometry, self._table.successors, self._routes, self._stage, world.x, world.y, world.speed,
            world.heading, world.target_speed, world.drivers,
        )  # fmt: skip

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        self._lanes.cut_in(world, row, event)


class GiveWay(Computed):
    """highway-env's regulated intersection: IDM along the path, and the give-way rule at 2.14 Hz."""

    # The rule's clock runs through the warm-up: 45 steps of it, one application every 7.
    phase = ((int(WARM_UP * WARM_UP_FREQUENCY) % REGULATION_INTERVAL) - 1) / WARM_UP_FREQUENCY

    def start(self, world: World) -> None:
        self._table = compiled_lanes(world.road)
        n = len(world.ids)
        routes = []
        for spec in world.specs:
            start = (f"o{spec.lane[0][2:]}", spec.lane[0], 0) if spec.lane[0].startswith("ir") else spec.lane
            if start[0].startswith("il"):  # already on the exit
                routes.append(self._table.route([start]))
            else:
                routes.append(self._table.route(path(start, spec.destination or "o1")))
        self._routes = np.array(routes)
        self._stage = np.zeros(n, np.int64)
        for _ in range(2):
            advance(self._table.geometry, self._routes, self._stage, world.x, world.y)
        self._exempt = np.array(
            [row == 0 or not spec.driver.gives_way for row, spec in enumerate(world.specs)]
        )
        if world.time == 0.0:
            self._clock = self.phase

    def accelerations(self, world: World) -> NDArray[np.float64]:
        geometry = self._table.geometry
        advance(geometry, self._routes, self._stage, world.x, world.y)
        # wrecks do not decide, but the rule must not revive them either: `accelerate` skips them
        if self._clock >= PERIOD - 1e-9:
            self._clock -= PERIOD
            regulate(
                geometry, self._routes, self._stage, world.x, world.y, world.speed, world.heading, self._exempt,
                world.target_speed, world.yielding,
            )  # fmt: skip
        self._clock += world.dt
        return path_accelerations(
            geometry, self._table.successors, self._routes, self._stage, world.x, world.y, world.speed,
            world.heading, world.target_speed, world.drivers,
        )  # fmt: skip

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        """There is one lane only."""
