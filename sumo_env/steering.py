"""Cars move sideways as in highway-env (`models.steering`), on SUMO's lanes.

SUMO's lane changes take one even motion that cannot be given up. So SUMO is told where on its lane each car is, the
distance to the middle included (``setLateralLanePosition``), and is told to count a car as being on the next lane at
once when it has crossed the line. SUMO's cars know no negative speed: one that rolls back is put where it is to be.
The world shows where cars were steered; SUMO's follow, 99 % of them within 0.2 m on every road
(tests/sumo_env/test_steering.py; docs/validation.md).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sumo_env.models.steering import BACK, HALF, move
from sumo_env.motion import Motion
from sumo_env.networks.catalogue import Network
from sumo_env.scene import Floats

if TYPE_CHECKING:
    from sumo_env.world import World

REACH = 30  # times its last piece that a joint is taken to go on


class Steering(Motion):
    """Where every car is to be, and the commands that bring SUMO's there.

    Attributes:
        entered: SUMO's lanes of the vehicles that have been placed since the last `start`.
    """

    def __init__(self, network: Network) -> None:
        super().__init__(network)
        self.entered: list[str] = []

    def learn_lanes(self, ids: Sequence[str], stretch: Floats) -> None:
        """Also the row in `_joints` of each, -1 for none."""
        super().learn_lanes(ids, stretch)
        shapes = {lane: self._network.shape(lane) for lane in ids}
        named = {lane.id for lane in self._network.lanes.values()}
        turning = [lane for lane in ids if lane not in named and len(shapes[lane]) > 2]
        joint = [turning.index(lane) if lane in turning else -1 for lane in ids]
        self._lanes = np.vstack((self._lanes, joint))
        self._joints = _prolonged([shapes[lane] for lane in turning])

    def start(self, world: World, first: int) -> None:
        """Take in the vehicles in columns from `first` on."""
        cars, fresh = world.cars, world.specs[first:]
        cars.x[first:] = [spec.x for spec in fresh]
        cars.y[first:] = [spec.y for spec in fresh]
        cars.heading[first:] = [spec.heading for spec in fresh]
        # not read: SUMO remembers where a car was that is placed again, until it steps
        numbers = world.sim.lane_numbers
        cars.lane[first:] = [numbers[lane] for lane in self.entered]
        self.entered.clear()
        x, y, heading = cars.pose[:, first:]
        cars.front[0, first:], cars.front[1, first:] = x + HALF * np.cos(heading), y + HALF * np.sin(heading)
        self.ego_near_end = True

    def act(self, world: World) -> None:
        """Also moves the cars."""
        cars = world.cars
        cars.speed[0] = world.ego.speed
        changes, self.ego_near_end = move(
            self._geometry, self._lanes, self._joints, self._stretch, cars.floats, cars.integers, cars.flags,
            world.dt,
        )  # fmt: skip
        if changes:
            self.change_lanes(world)
        world.fleet.command(cars.command, cars.lateral, cars.moved)

    def change_lanes(self, world: World) -> None:
        """Also put back those who are to be behind where SUMO has them."""
        cars = world.cars
        for row in np.flatnonzero(cars.change >= 0).tolist():
            beside = self._ids[cars.lane[row]].rsplit("_", 1)[0]
            index = int(self._lanes[2, cars.lane[row]]) - 1 - int(cars.change[row])
            world.sim.move_to_lane(world.ids[row], f"{beside}_{index}")
        for row in np.flatnonzero(cars.change == BACK).tolist():
            self._put_back(world, row)

    def _put_back(self, world: World, row: int) -> None:
        """Put SUMO's car where it is to be, which is behind it, on its lane or those that it came along."""
        cars, name, network = world.cars, world.ids[row], self._network
        x = float(cars.x[row]) + HALF * math.cos(cars.heading[row])
        y = float(cars.y[row]) + HALF * math.sin(cars.heading[row])
        lane = self._ids[cars.lane[row]]
        apart, ahead, left = nearest(network.shape(lane), x, y)
        if ahead == 0.0:
            for before in self._before(world, name, lane):
                found = nearest(network.shape(before), x, y)
                if found[0] < apart:
                    lane, (apart, ahead, left) = before, found
        world.sim.put(name, lane, ahead * network.stretch(lane))
        cars.lateral[row], cars.moved[row] = left, True

    def _before(self, world: World, name: str, lane: str) -> list[str]:
        """The lanes before a vehicle's on its route, and the joints between."""
        near = self._network.preceding
        if lane[0] == ":":
            return list(near[lane])
        joints = [one for one in near[lane] if world.sim.can_be_on(name, near[one][0].rsplit("_", 1)[0])]
        return joints + [near[one][0] for one in joints]


def nearest(points: Sequence[tuple[float, float]], x: float, y: float) -> tuple[float, float, float]:
    """How far (x, y) is from a line of points, how far along that is, and how far to the left of it [m]."""
    best, begin = (math.inf, 0.0, 0.0), 0.0
    for (x1, y1), (x2, y2) in pairwise(points):
        length = math.dist((x1, y1), (x2, y2))
        cos, sin = (x2 - x1) / length, (y2 - y1) / length
        s = min(max((x - x1) * cos + (y - y1) * sin, 0.0), length)
        apart = math.dist((x1 + s * cos, y1 + s * sin), (x, y))
        if apart < best[0]:
            best = apart, begin + s, (x - x1) * sin - (y - y1) * cos
        begin += length
    return best


def _prolonged(lines: Sequence[Sequence[tuple[float, float]]]) -> Floats:
    """Lines of points as one array, going straight on at both ends."""
    most = max(map(len, lines), default=0)
    rows = []
    for line in lines:
        points = np.array(line)
        back, out = points[0] - points[1], points[-1] - points[-2]
        steps = np.arange(1, most - len(line) + 2)
        rows.append(np.vstack([points[0] + REACH * back, points, points[-1] + REACH * np.outer(steps, out)]))
    return np.array(rows).reshape(len(lines), most + 2, 2)
