"""Traffic on roads of bends by highway-env's rules: IDM along the path, its MOBIL, and its right of way at crossings.

Decisions and accelerations are `models.network_drivers`', right of way is `models.give_way`'s.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from networks.roads import LaneIndex, Road
from sumo_env.computed import Computed
from sumo_env.drivers import RiskEvent
from sumo_env.models.give_way import PERIOD, regulate
from sumo_env.models.lane_table import advance
from sumo_env.models.network_drivers import Net, drive, net
from sumo_env.tasks.intersection import REGULATION_INTERVAL, WARM_UP, WARM_UP_FREQUENCY, compiled_lanes, path

if TYPE_CHECKING:
    from sumo_env.world import World


LONGEST_WAY = 14  # lanes: an entry, its curve, once around the ring, an exit

State = dict[str, NDArray[Any]]


@lru_cache(maxsize=4)
def joined_lanes(road: Road) -> Net:
    """The road for `models.network_drivers`."""
    return net(compiled_lanes(road))


class Bends(Computed):
    """highway-env's IDM and MOBIL on a road of bends and joins."""

    _lane: NDArray[np.int64]
    _target: NDArray[np.int64]
    _ways: NDArray[np.int64]
    _leg: NDArray[np.int64]
    _planned: NDArray[np.int64]
    _timer: NDArray[np.float64]
    _changes: NDArray[np.bool_]
    _forced: NDArray[np.bool_]
    _rows: dict[str, int]

    def start(self, world: World) -> None:
        self._net = joined_lanes(world.road)
        self._names = list(world.road.lanes)
        self._number = {name: number for number, name in enumerate(self._names)}
        n = len(world.specs)
        fresh: State = {
            "_lane": np.array([self._number[spec.lane] for spec in world.specs]),
            "_target": np.array([self._number[spec.lane] for spec in world.specs]),
            "_ways": np.array([self._way(world, row) for row in range(n)]),
            "_leg": np.zeros(n, np.int64),
            # a route in highway-env names the lane on which it begins, and MOBIL does not leave it
            "_planned": np.array([spec.lane[2] for spec in world.specs]),
            "_timer": np.array([spec.timer for spec in world.specs]),
            "_changes": np.array([spec.changes_lanes for spec in world.specs]),
            "_forced": np.zeros(n, np.bool_),
        }
        before = {} if world.time == 0.0 else self._rows
        stayed = [(row, before[name]) for row, name in enumerate(world.ids) if name in before]
        for field, values in fresh.items():
            for row, old in stayed:
                values[row] = getattr(self, field)[old]
            setattr(self, field, values)
        self._rows = dict(world.row)

    def _way(self, world: World, row: int) -> list[int]:
        """The roads of a vehicle's way, by their first lanes, as a row of `ways`."""
        lanes = world.road.way(world.specs[row].lane, world.specs[row].destination)
        roads = [self._number[start, end, 0] for start, end, _ in lanes]
        return roads + [-1] * (LONGEST_WAY - len(roads))

    def act(self, world: World) -> None:
        self._target[0] = self._number[world.ego.target_lane]
        self._forced &= self._lane != self._target
        acts = ~world.crashed
        acts[0] = False
        acceleration = drive(
            self._net, self._ways, self._leg, self._planned, self._lane, self._target, self._timer, world.x, world.y,
            world.speed, world.heading, world.target_speed, world.drivers, acts, self._changes & ~self._forced,
            world.time > 0.0,
        )  # fmt: skip
        self._timer += world.dt
        world.accelerate(world.push(acceleration))

    def targets(self, world: World) -> NDArray[np.int64]:
        return self._target

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        start, end, lane = self._names[self._target[row]]
        for k in (lane + event.direction, lane - event.direction):
            target: LaneIndex = (start, end, k)
            if target in self._number and world.has_room(row, target):
                self._target[row] = self._number[target]
                self._forced[row] = True
                return


class GiveWay(Bends):
    """highway-env's regulated intersection: `Bends`, and the give-way rule at 2.14 Hz."""

    # The rule's clock runs through the warm-up: 45 steps of it, one application every 7.
    phase = ((int(WARM_UP * WARM_UP_FREQUENCY) % REGULATION_INTERVAL) - 1) / WARM_UP_FREQUENCY

    def start(self, world: World) -> None:
        super().start(world)
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

    def act(self, world: World) -> None:
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
        super().act(world)

    def cut_in(self, world: World, row: int, event: RiskEvent) -> None:
        """There is one lane only."""
