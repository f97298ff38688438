"""How the cars of a world come to be where they are to be: what they are told, step by step, of SUMO's lanes.

`steering.Steering` puts every car where highway-env's controller would have it. Elsewhere cars keep to SUMO's lanes,
change them by SUMO's own motion, and are told no more than how fast to drive (`OnLanes`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from sumo_env import direct
from sumo_env.loop import Traffic
from sumo_env.models.lane_table import compiled_lanes
from sumo_env.models.motion import keep_to_lanes
from sumo_env.native import CENTRED
from sumo_env.networks.catalogue import Network
from sumo_env.scenario import EGO
from sumo_env.scene import Floats

if TYPE_CHECKING:
    from sumo_env.world import World


class Motion:
    """What both ways of moving cars share.

    Attributes:
        ego_near_end: whether the ego may have to be given the next lane of its way to steer for.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        table = compiled_lanes(network.road)
        self._geometry, self._number = table.geometry, table.index
        self.ego_near_end = True
        self._joints: Floats = np.empty((0, 0, 2))
        self._called: tuple[Callable[[], object], ...] | None = None

    def learn_lanes(self, ids: Sequence[str], stretch: Floats) -> None:
        """What is to be known of each of SUMO's lanes, by number; `stretch` of each, shape (lanes,).

        `_lanes`, shape (3, lanes): number of highway-env's lane, -1 for none; its place from the left; and lanes beside
        each other, 0 where none can be changed to.
        """
        self._ids = ids
        road, indices = self._network.road, [self._network.indices.get(lane) for lane in ids]
        # of a joint: those of the lane that it leads to, without neighbours
        on = [-1 if index is None else self._number[index] for index in indices]
        place = [-1 if index is None else index[2] for index in indices]
        beside = [0 if index is None else road.count(*index[:2]) for index in indices]
        count = [0 if lane[0] == ":" else n for lane, n in zip(ids, beside, strict=True)]
        self._lanes = np.array([on, place, count])
        self._stretch = stretch

    def aim(self, world: World) -> None:
        """Note the ego's target lane."""
        world.cars.target[0] = self._number[world.ego.target_lane]

    def traffic(self, world: World) -> Traffic | None:
        """The vehicles for `loop`; None where SUMO's functions cannot be called directly."""
        handles, cars = world.fleet.handles(), world.cars
        if handles is None:
            return None
        if self._called is None:  # and kept, because compiled code calls them
            sim = world.sim
            changes = partial(self.change_lanes, world)
            self._called = (lambda: sim.step()), world.sumo_sees_contact, changes, world.follow_road
            self._calls = direct.python_calls(*self._called)
        return Traffic(
            *handles, self._calls, self._geometry, self._lanes, self._joints, self._stretch, cars.floats,
            cars.integers, cars.flags, world.drivers,
        )  # fmt: skip

    def act(self, world: World) -> None:
        """Command SUMO's cars for the next step; the ego's way is known."""
        raise NotImplementedError

    def change_lanes(self, world: World) -> None:
        """Have those change lane in SUMO who are to do so now."""
        raise NotImplementedError


class OnLanes(Motion):
    """Cars keep to SUMO's lanes. The ego, wrecks, and whose acceleration is computed are told how fast to drive."""

    def learn_lanes(self, ids: Sequence[str], stretch: Floats) -> None:
        """Also how much faster than on the ground the ego, and others who are told, are to drive on each."""
        super().learn_lanes(ids, stretch)
        # others are told metres where all lanes are about as long in SUMO as on the ground
        self._stretch = np.array([stretch, stretch if self._network.uneven else np.ones(len(ids))])

    def aim(self, world: World) -> None:
        """Its end may be near, for all that is known."""
        super().aim(world)
        self.ego_near_end = True

    def act(self, world: World) -> None:
        """Tell speeds, and the ego's change of lane."""
        cars = world.cars
        cars.own_speed[0] = world.ego.speed
        keep_to_lanes(cars.floats, cars.integers, cars.flags, self._stretch, world.dt)
        world.fleet.set_speeds(cars.command)
        self.change_lanes(world)
        self.ego_near_end = True  # where SUMO's step takes it, for all that is known

    def change_lanes(self, world: World) -> None:
        """Only the ego's changes are commanded here, once: `loop` asks whenever it is not on the lane of its choice."""
        ego, lane = world.ego, world.lane[0]
        start, end, target = ego.target_lane
        _, place, count = self._lanes[:, lane].tolist()
        if ego.crashed or count == 0 or place == target or abs(world.sim.lateral_position(EGO)) >= CENTRED:
            return
        if world.task.name == "two-way":  # the strip at y = 0 is SUMO's opposite lane
            world.sim.change_lane_relative(EGO, 1 if target == 0 else -1)
        elif count == world.road.count(start, end):
            world.sim.change_lane(EGO, count - 1 - target)
