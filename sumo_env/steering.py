"""Cars move sideways as in highway-env (`models.steering`), on SUMO's lanes.

SUMO's lane changes take one even motion that cannot be given up. So SUMO is told where on its lane each car is, the
distance to the middle included (``setLateralLanePosition``), and is told to count a car as being on the next lane at
once when it has crossed the line. The world shows where cars were steered; SUMO's follow within centimetres, or
within half a metre on the joints of the roundabout (tests/sumo_env/test_steering.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from networks.catalogue import Network
from networks.lanes import WIDTH
from sumo_env.computed import Computed
from sumo_env.models.steering import offsets, steer
from sumo_env.scene import Floats
from sumo_env.simulation import HALF
from sumo_env.tasks.intersection import compiled_lanes

if TYPE_CHECKING:
    from sumo_env.world import World

STILL = 1e-4  # [m] sideways that SUMO need not be told


class Steering:
    """Where every car is to be, and the commands that bring SUMO's there.

    Attributes:
        distance: that each car drives in the next step [m], shape (n,); set by the world before `act`.
        x, y, heading: of the cars [m, m, rad], shape (n,); after `act`, those at the end of the step.
    """

    x: Floats
    y: Floats
    heading: Floats
    _lateral: Floats

    def __init__(self, network: Network, rule: Computed) -> None:
        self._rule = rule
        self._geometry = compiled_lanes(network.road).geometry
        self._number = {name: number for number, name in enumerate(network.road.lanes)}
        # SUMO lane -> number of highway-env's (of a joint: of the lane that it leads to), lane id, lanes beside each
        # other (0: a joint, which has no neighbours), stretch
        self._lanes = {
            lane: (
                self._number[index],
                index[2],
                0 if lane.startswith(":") else network.road.count(*index[:2]),
                network.stretch(lane),
            )
            for lane, index in network.indices.items()
        }

    def start(self, world: World, keep: dict[str, int]) -> None:
        """Take new vehicles in; rows of `keep` (id -> old row) keep their state."""
        state = np.array([[spec.x, spec.y, spec.heading, 0.0] for spec in world.specs])
        for row, name in enumerate(world.ids):
            if name in keep:
                old = keep[name]
                state[row] = self.x[old], self.y[old], self.heading[old], self._lateral[old]
        self.x, self.y, self.heading, self._lateral = (np.ascontiguousarray(column) for column in state.T)
        self.distance = np.zeros(len(world.ids))
        self.look(world)

    def act(self, world: World) -> None:
        """Command SUMO for the next step."""
        target = self._rule.targets(world)
        target[0] = self._number[world.ego.target_lane]
        steer(self._geometry, target, self.x, self.y, self.heading, self.distance, world.crashed, world.dt)
        # front bumpers are what SUMO moves along its lanes
        x, y = self.x + HALF * np.cos(self.heading), self.y + HALF * np.sin(self.heading)
        lanes = [self._lanes[world.sim.lane_of(name)] for name in world.ids]
        along, right = offsets(
            self._geometry, np.array([lane[0] for lane in lanes]), self._front_x, self._front_y, x, y
        )
        for row, name in enumerate(world.ids):
            _, lane, count, stretch = lanes[row]
            lateral = self._lateral[row] - right[row]
            if lateral > WIDTH / 2 and 0 < lane < count:
                lateral -= WIDTH
                world.sim.change_lane(name, count - lane)
            elif lateral < -WIDTH / 2 and lane + 1 < count:
                lateral += WIDTH
                world.sim.change_lane(name, count - 2 - lane)
            if abs(lateral) > STILL or abs(self._lateral[row]) > STILL:
                world.sim.set_lateral_position(name, lateral)
            self._lateral[row] = lateral
            world.sim.set_speed(name, max(along[row], 0.0) / world.dt * stretch)

    def look(self, world: World) -> None:
        """After a step: SUMO's cars have moved, and what the world shows is where they were steered."""
        self._front_x = world.x + HALF * np.cos(world.heading)
        self._front_y = world.y + HALF * np.sin(world.heading)
        world.x, world.y, world.heading = self.x.copy(), self.y.copy(), self.heading.copy()
