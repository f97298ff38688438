"""Cars move sideways as in highway-env (`models.steering`), on SUMO's lanes.

SUMO's lane changes take one even motion that cannot be given up. So SUMO is told where on its lane each car is, the
distance to the middle included (``setLateralLanePosition``), and is told to count a car as being on the next lane at
once when it has crossed the line. The world shows where cars were steered; SUMO's follow, most within centimetres
(95 % within half a metre on every road, tests/sumo_env/test_steering.py; docs/validation.md has the rest).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from networks.catalogue import Network
from sumo_env.computed import Computed
from sumo_env.models.steering import HALF, follow, steer
from sumo_env.scene import Floats
from sumo_env.tasks.intersection import compiled_lanes

if TYPE_CHECKING:
    from sumo_env.world import World

STILL = 1e-4  # [m] sideways that SUMO need not be told


class Steering:
    """Where every car is to be, and the commands that bring SUMO's there.

    Attributes:
        distance: that each car drives in the next step [m], shape (n,); set by the world before `act`.
        pose: x, y [m] and heading [rad] of the cars, shape (3, n); after `act`, those at the end of the step.
    """

    pose: Floats
    _lateral: Floats  # of SUMO's cars, to the left of the middle of their lanes [m]

    def __init__(self, network: Network, rule: Computed) -> None:
        self._network = network
        self._rule = rule
        self._geometry = compiled_lanes(network.road).geometry
        self._number = {name: number for number, name in enumerate(network.road.lanes)}

    def learn_lanes(self, ids: Sequence[str], stretch: Floats) -> None:
        """What is to be known of each of SUMO's lanes, by number; `stretch` of each, shape (lanes,)."""
        road, indices = self._network.road, [self._network.indices.get(lane) for lane in ids]
        # of a joint: those of the lane that it leads to, without neighbours
        self._on = np.array([-1 if index is None else self._number[index] for index in indices])
        self._place = np.array([-1 if index is None else index[2] for index in indices])
        beside = [0 if index is None else road.count(*index[:2]) for index in indices]
        self._count = np.array([0 if lane[0] == ":" else n for lane, n in zip(ids, beside, strict=True)])
        self._stretch = stretch

    def start(self, world: World, keep: dict[str, int]) -> None:
        """Take new vehicles in; rows of `keep` (id -> old row) keep their state."""
        state = np.array([[spec.x, spec.y, spec.heading, 0.0] for spec in world.specs]).T
        for name, old in keep.items():
            state[:3, world.row[name]], state[3, world.row[name]] = self.pose[:, old], self._lateral[old]
        n = len(world.ids)
        self.pose, self._lateral = np.ascontiguousarray(state[:3]), state[3].copy()
        self.distance = np.zeros(n)
        self._front = np.empty((2, n))
        self._speed = np.empty(n)
        self._change = np.empty(n, np.int64)
        self.look(world)

    def act(self, world: World) -> None:
        """Command SUMO for the next step."""
        target = self._rule.targets(world)
        target[0] = self._number[world.ego.target_lane]
        x, y, heading = self.pose
        steer(self._geometry, target, x, y, heading, self.distance, world.crashed, world.dt)
        moved = np.abs(self._lateral) > STILL
        follow(
            self._geometry, world.lane, self._on, self._place, self._count, self._stretch, self._front, x, y, heading,
            world.dt, self._lateral, self._speed, self._change,
        )  # fmt: skip
        for row in np.flatnonzero(self._change >= 0).tolist():
            count = int(self._count[world.lane[row]])
            world.sim.change_lane(world.ids[row], count - 1 - int(self._change[row]))
        moved |= np.abs(self._lateral) > STILL
        for row in np.flatnonzero(moved).tolist():
            world.sim.set_lateral_position(world.ids[row], float(self._lateral[row]))
        world.fleet.set_speeds(self._speed)

    def look(self, world: World) -> None:
        """After a step: SUMO's cars have moved, and what the world shows is where they were steered."""
        self._front[0] = world.x + HALF * np.cos(world.heading)
        self._front[1] = world.y + HALF * np.sin(world.heading)
        world.state[:3] = self.pose
