"""Traffic on roads of bends by highway-env's rules: IDM along the path, its MOBIL, and its right of way at crossings.

Decisions and accelerations are `models.network_drivers`', right of way is `models.give_way`'s.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sumo_env.computed import Computed
from sumo_env.drivers import RiskEvent
from sumo_env.loop import Progress, Traffic, Ways, bends
from sumo_env.models.give_way import give_way
from sumo_env.models.lane_net import Net, net
from sumo_env.models.lane_table import Integers, advance, compiled_lanes
from sumo_env.models.network_drivers import act
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scenario import VehicleSpec
from sumo_env.scene import Floats
from sumo_env.tasks.intersection import REGULATION_INTERVAL, WARM_UP, WARM_UP_FREQUENCY, path

if TYPE_CHECKING:
    from sumo_env.world import World


NOBODY_GIVES_WAY = np.empty((0, 1), np.int64), np.empty(0, np.int64), np.empty(0, np.bool_), np.zeros(1)
LONGEST_WAY = 14  # lanes: an entry, its curve, once around the ring, an exit

@lru_cache(maxsize=4)
def joined_lanes(road: Road) -> Net:
    """The road for `models.lane_net`."""
    return net(compiled_lanes(road))


class Rows:
    """A row of numbers for each first lane and destination, worked out at first use; kept in one array, to be quick."""

    def __init__(self, row: Callable[[Road, LaneIndex, str | None], list[int]], road: Road) -> None:
        self._row, self._road = row, road
        self._number: dict[tuple[LaneIndex, str | None], int] = {}
        self._rows: Integers = np.empty((0, 0), np.int64)

    def of(self, specs: Sequence[VehicleSpec]) -> Integers:
        """The rows of these vehicles, shape (n, length of a row)."""
        keys = [(spec.lane, spec.destination) for spec in specs]
        for key in keys:
            if key not in self._number:
                row, number = np.array([self._row(self._road, *key)]), len(self._rows)
                self._rows = np.concatenate((self._rows, row)) if number else row
                self._number[key] = number
        return self._rows.take([self._number[key] for key in keys], axis=0)


def _way(road: Road, lane: LaneIndex, destination: str | None) -> list[int]:
    """The roads of a vehicle's way, by their first lanes, as a row of `ways`."""
    number = compiled_lanes(road).index
    roads = [number[start, end, 0] for start, end, _ in road.way(lane, destination)]
    return roads + [-1] * (LONGEST_WAY - len(roads))


class Bends(Computed):
    """highway-env's IDM and MOBIL on a road of bends and joins."""

    _ways: Ways

    def __init__(self, road: Road) -> None:
        lanes = compiled_lanes(road)
        self._number, self._names, self._geometry = lanes.index, lanes.names, lanes.geometry
        self._net = joined_lanes(road)
        self._rows = Rows(_way, road)

    def start(self, world: World, first: int) -> None:
        cars, fresh = world.cars, world.specs[first:]
        cars.on[first:] = [self._number[spec.lane] for spec in fresh]
        cars.target[first:] = cars.on[first:]
        # a route in highway-env names the lane on which it begins, and MOBIL does not leave it
        cars.planned[first:] = [spec.lane[2] for spec in fresh]
        cars.timer[first:] = [spec.timer for spec in fresh]
        cars.changes[first:] = [spec.changes_lanes for spec in fresh]
        self._ways = Ways(self._net, self._rows.of(world.specs), *NOBODY_GIVES_WAY)

    def accelerate(self, world: World) -> None:
        cars, ways = world.cars, self._ways
        act(
            ways.roads, ways.ways, cars.floats, cars.integers, cars.flags, world.drivers, world.time > 0.0, world.dt
        )

    def drive(self, world: World, traffic: Traffic, count: int, progress: Progress) -> Progress:
        return bends(traffic, count, self._ways, progress, world.ego.target_speed, world.dt)

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        cars = world.cars
        start, end, lane = self._names[cars.target[row]]
        for k in (lane + event.direction, lane - event.direction):
            target: LaneIndex = (start, end, k)
            if target in self._number and world.has_room(row, target):
                cars.target[row], cars.forced[row] = self._number[target], True
                return


def _route(road: Road, lane: LaneIndex, destination: str | None) -> list[int]:
    """The lanes of a vehicle's way through the intersection, as a row of `routes`."""
    start = (f"o{lane[0][2:]}", lane[0], 0) if lane[0].startswith("ir") else lane
    lanes = [start] if start[0].startswith("il") else path(start, destination or "o1")  # already on the exit
    return compiled_lanes(road).route(lanes).tolist()


class GiveWay(Bends):
    """highway-env's regulated intersection: `Bends`, and the give-way rule at 2.14 Hz."""

    # The rule's clock runs through the warm-up: 45 steps of it, one application every 7.
    phase = ((int(WARM_UP * WARM_UP_FREQUENCY) % REGULATION_INTERVAL) - 1) / WARM_UP_FREQUENCY

    def __init__(self, road: Road) -> None:
        super().__init__(road)
        self._routes = Rows(_route, road)

    def start(self, world: World, first: int) -> None:
        super().start(world, first)
        routes = self._routes.of(world.specs)
        stage = np.zeros(len(routes), np.int64)
        advance(self._geometry, routes, stage, world.x, world.y)
        exempt = np.array([row == 0 or not spec.driver.gives_way for row, spec in enumerate(world.specs)])
        clock = np.array([self.phase]) if world.time == 0.0 else self._clock
        self._clock: Floats = clock
        self._ways = Ways(self._net, self._ways.ways, routes, stage, exempt, clock)

    def accelerate(self, world: World) -> None:
        # wrecks do not decide, but the rule must not revive them either: they only coast
        cars, ways = world.cars, self._ways
        give_way(
            self._geometry, ways.routes, ways.stage, ways.exempt, ways.clock, cars.floats, cars.flags, world.dt
        )
        super().accelerate(world)

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        """There is one lane only."""
