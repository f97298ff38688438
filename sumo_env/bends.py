"""Traffic on roads of bends by highway-env's rules: IDM along the path, its MOBIL, and its right of way at crossings.

Decisions and accelerations are `models.network_drivers`', right of way is `models.give_way`'s.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from networks.roads import LaneIndex, Road
from sumo_env.computed import Computed
from sumo_env.drivers import RiskEvent
from sumo_env.models.give_way import PERIOD, regulate
from sumo_env.models.lane_table import advance
from sumo_env.models.network_drivers import Net, act, net
from sumo_env.tasks.intersection import REGULATION_INTERVAL, WARM_UP, WARM_UP_FREQUENCY, compiled_lanes, path

if TYPE_CHECKING:
    from sumo_env.world import World


LONGEST_WAY = 14  # lanes: an entry, its curve, once around the ring, an exit

@lru_cache(maxsize=4)
def joined_lanes(road: Road) -> Net:
    """The road for `models.network_drivers`."""
    return net(compiled_lanes(road))


@lru_cache(maxsize=256)
def _way(road: Road, lane: LaneIndex, destination: str | None) -> tuple[int, ...]:
    """The roads of a vehicle's way, by their first lanes, as a row of `ways`."""
    number = {name: number for number, name in enumerate(road.lanes)}
    roads = [number[start, end, 0] for start, end, _ in road.way(lane, destination)]
    return (*roads, *[-1] * (LONGEST_WAY - len(roads)))


class Bends(Computed):
    """highway-env's IDM and MOBIL on a road of bends and joins."""

    _ways: NDArray[np.int64]

    def start(self, world: World, first: int) -> None:
        cars, fresh = world.cars, world.specs[first:]
        self._net = joined_lanes(world.road)
        self._names = list(world.road.lanes)
        self._number = {name: number for number, name in enumerate(self._names)}
        cars.on[first:] = cars.target[first:] = [self._number[spec.lane] for spec in fresh]
        # a route in highway-env names the lane on which it begins, and MOBIL does not leave it
        cars.planned[first:] = [spec.lane[2] for spec in fresh]
        cars.timer[first:] = [spec.timer for spec in fresh]
        cars.changes[first:] = [spec.changes_lanes for spec in fresh]
        self._ways = np.array([_way(world.road, spec.lane, spec.destination) for spec in world.specs])

    def accelerate(self, world: World) -> None:
        cars = world.cars
        act(
            self._net, self._ways, cars.floats, cars.integers, cars.flags, world.drivers, world.time > 0.0, world.dt
        )

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        cars = world.cars
        start, end, lane = self._names[cars.target[row]]
        for k in (lane + event.direction, lane - event.direction):
            target: LaneIndex = (start, end, k)
            if target in self._number and world.has_room(row, target):
                cars.target[row], cars.forced[row] = self._number[target], True
                return


@lru_cache(maxsize=256)
def _route(road: Road, lane: LaneIndex, destination: str | None) -> tuple[int, ...]:
    """The lanes of a vehicle's way through the intersection, as a row of `routes`."""
    start = (f"o{lane[0][2:]}", lane[0], 0) if lane[0].startswith("ir") else lane
    lanes = [start] if start[0].startswith("il") else path(start, destination or "o1")  # already on the exit
    return tuple(compiled_lanes(road).route(lanes).tolist())


class GiveWay(Bends):
    """highway-env's regulated intersection: `Bends`, and the give-way rule at 2.14 Hz."""

    # The rule's clock runs through the warm-up: 45 steps of it, one application every 7.
    phase = ((int(WARM_UP * WARM_UP_FREQUENCY) % REGULATION_INTERVAL) - 1) / WARM_UP_FREQUENCY

    def start(self, world: World, first: int) -> None:
        super().start(world, first)
        self._table = compiled_lanes(world.road)
        self._routes = np.array([_route(world.road, spec.lane, spec.destination) for spec in world.specs])
        self._stage = np.zeros(len(world.ids), np.int64)
        for _ in range(2):
            advance(self._table.geometry, self._routes, self._stage, world.x, world.y)
        self._exempt = np.array(
            [row == 0 or not spec.driver.gives_way for row, spec in enumerate(world.specs)]
        )
        if world.time == 0.0:
            self._clock = self.phase

    def accelerate(self, world: World) -> None:
        # wrecks do not decide, but the rule must not revive them either: they only coast
        if self._clock >= PERIOD - 1e-9:
            self._clock -= PERIOD
            advance(self._table.geometry, self._routes, self._stage, world.x, world.y)
            regulate(
                self._table.geometry, self._routes, self._stage, world.x, world.y, world.speed, world.heading,
                self._exempt, world.target_speed, world.yielding,
            )  # fmt: skip
        self._clock += world.dt
        super().accelerate(world)

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        """There is one lane only."""
