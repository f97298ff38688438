"""Cars move sideways as in highway-env (`models.steering`), on SUMO's lanes.

SUMO's lane changes take one even motion that cannot be given up. So SUMO is told where on its lane each car is, the
distance to the middle included (``setLateralLanePosition``), and is told to count a car as being on the next lane at
once when it has crossed the line. The world shows where cars were steered; SUMO's follow, most within centimetres
(95 % within half a metre on every road, tests/sumo_env/test_steering.py; docs/validation.md has the rest).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from networks.catalogue import Network
from sumo_env import direct
from sumo_env.loop import Traffic
from sumo_env.models.lane_table import compiled_lanes
from sumo_env.models.steering import HALF, move
from sumo_env.scene import Floats

if TYPE_CHECKING:
    from sumo_env.world import World


class Steering:
    """Where every car is to be, and the commands that bring SUMO's there.

    Attributes:
        ego_near_end: whether the ego may have to be given the next lane of its way to steer for.
        entered: SUMO's lanes of the vehicles that have been placed since the last `start`.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._geometry = compiled_lanes(network.road).geometry
        self._number = {name: number for number, name in enumerate(network.road.lanes)}
        self.ego_near_end = True
        self.entered: list[str] = []
        self._called: tuple[Callable[[], bool], ...] | None = None

    def learn_lanes(self, ids: Sequence[str], stretch: Floats) -> None:
        """What is to be known of each of SUMO's lanes, by number; `stretch` of each, shape (lanes,)."""
        self._ids = ids
        road, indices = self._network.road, [self._network.indices.get(lane) for lane in ids]
        # of a joint: those of the lane that it leads to, without neighbours
        on = [-1 if index is None else self._number[index] for index in indices]
        place = [-1 if index is None else index[2] for index in indices]
        beside = [0 if index is None else road.count(*index[:2]) for index in indices]
        count = [0 if lane[0] == ":" else n for lane, n in zip(ids, beside, strict=True)]
        self._lanes = np.array([on, place, count])
        self._stretch = stretch

    def start(self, world: World, first: int) -> None:
        """Take in the vehicles in columns from `first` on."""
        cars = world.cars
        for column, spec in enumerate(world.specs[first:], start=first):
            cars.pose[:, column] = spec.x, spec.y, spec.heading
        # not read: SUMO remembers where a car was that is placed again, until it steps
        numbers = world.sim.lane_numbers
        cars.lane[first:] = [numbers[lane] for lane in self.entered]
        self.entered.clear()
        x, y, heading = cars.pose[:, first:]
        cars.front[0, first:], cars.front[1, first:] = x + HALF * np.cos(heading), y + HALF * np.sin(heading)
        self.ego_near_end = True

    def aim(self, world: World) -> None:
        """Let the ego steer for its target lane."""
        world.cars.target[0] = self._number[world.ego.target_lane]

    def traffic(self, world: World) -> Traffic | None:
        """The vehicles for `loop`; None where SUMO's functions cannot be called directly."""
        handles, cars = world.fleet.handles(), world.cars
        if handles is None:
            return None
        if self._called is None:  # and kept, because compiled code calls them
            sim = world.sim
            change = sim.guarded(partial(self._change_lanes, world))
            self._called = sim.guarded(lambda: sim.step()), world.sumo_sees_contact, change
            self._calls = direct.python_calls(*self._called)
        return Traffic(
            *handles, self._calls, self._geometry, self._lanes, self._stretch, cars.floats, cars.integers, cars.flags,
            world.drivers,
        )  # fmt: skip

    def act(self, world: World) -> None:
        """Move the cars, and command SUMO's for the next step."""
        cars = world.cars
        changes, self.ego_near_end = move(
            self._geometry, self._lanes, self._stretch, cars.floats, cars.integers, cars.flags, world.dt
        )
        if changes:
            self._change_lanes(world)
        world.fleet.command(cars.command, cars.lateral, cars.moved)

    def _change_lanes(self, world: World) -> None:
        cars = world.cars
        for row in np.flatnonzero(cars.change >= 0).tolist():
            beside = self._ids[cars.lane[row]].rsplit("_", 1)[0]
            index = int(self._lanes[2, cars.lane[row]]) - 1 - int(cars.change[row])
            world.sim.move_to_lane(world.ids[row], f"{beside}_{index}")
