"""The ego's route on a SUMO network: what is left of it, and how far each of its lanes leads."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

from sumo_env.config import ConfigError
from sumo_env.networks import files
from sumo_env.networks.mapping import Network
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.tasks.base import EgoState


class Way:
    """A route as lanes and joints.

    Attributes:
        limit: highest speed limit on the route [m/s].
        zone: before an end, within reach of one policy step at the limit [m].
        starts: lanes of the first edge from which the rest of the route can be driven.

    Raises:
        ConfigError: the route cannot be driven; the message names the edge.
    """

    def __init__(self, network: Network, edges: Sequence[str], reach: float) -> None:
        twice = [edge for place, edge in enumerate(edges) if edge in edges[:place]]
        if twice:
            raise ConfigError(f"ego_route leads over edge {twice[0]!r} twice")
        road = self._network_road = network.road
        leads = network.road.leads
        self._joints = {  # ways through the junctions of the route, each with the lanes that it joins
            joint: (index, leads[joint][0])
            for edge, following in pairwise(edges)
            for index in _lanes(road, edge)
            for joint in leads[index]
            if joint[1] == f"{following}:from"
        }
        parts = [*(index for edge in edges for index in _lanes(road, edge)), *self._joints]
        self._road = Road(road.name, {index: road.lane(index) for index in parts})
        self.limit = max(road.lane(files.lane(edge)).speed_limit for edge in edges)
        self.zone = self.limit + reach
        # from the end of each edge and each junction to the end of the route [m], along the shortest lanes
        self._remaining: dict[tuple[str, str], float] = {}
        # from the start of each lane and each joint: how far it leads without a lane change [m]; inf to the end
        self._free: dict[LaneIndex, float] = dict.fromkeys(_lanes(road, edges[-1]), math.inf)
        self.starts = self._follow(edges)

    def _follow(self, edges: Sequence[str]) -> tuple[int, ...]:
        """Measure the route from its end on; returns the numbers of the lanes to start in.

        On edges longer than two zones there is time for a lane change.
        """
        left, drivable = 0.0, set(_lanes(self._road, edges[-1]))
        for edge, following in reversed(list(pairwise((*edges, "")))):
            lanes, nodes = _lanes(self._road, edge), (f"{edge}:to", f"{following}:from")
            if following:
                joints = {joint: ends for joint, ends in self._joints.items() if joint[:2] == nodes}
                onward = {start for start, end in joints.values() if end in drivable}
                if not onward:
                    raise ConfigError(
                        f"ego_route: edge {edge!r} leads to edge {following!r} only in lanes from which the route does "
                        "not go on, and the edge is too short for a lane change"
                    )
                self._remaining[nodes] = left
                left += self._shortest(joints)
                for joint, (_, end) in joints.items():
                    self._free[joint] = self._road.lane(joint).length + self._free[end]
                for index in lanes:
                    ways = [self._free[joint] for joint, (start, _) in joints.items() if start == index]
                    self._free[index] = self._road.lane(index).length + max(ways, default=0.0)
                drivable = onward if self._road.lane(lanes[0]).length < 2 * self.zone else set(lanes)
            self._remaining[lanes[0][:2]] = left
            left += self._shortest(lanes)
        if left < 2 * self.zone:
            raise ConfigError(
                f"ego_route from edge {edges[0]!r} to edge {edges[-1]!r} is {left:.0f} m long; the ego needs "
                f"{2 * self.zone:.0f} m, two seconds at the speed limit"
            )
        return tuple(sorted(number for *_, number in drivable))

    def _shortest(self, lanes: Iterable[LaneIndex]) -> float:
        return min(self._road.lane(index).length for index in lanes)

    def _place(self, ego: EgoState) -> tuple[LaneIndex, float]:
        """The ego's lane on its route, and its place there [m]; other roads may lie over or under it."""
        x, y = self._network_road.lane(ego.lane).position(ego.s, ego.lateral)
        index = self._road.closest_lane(x, y, ego.heading)
        return index, self._road.lane(index).local_coordinates(x, y)[0]

    def remaining(self, ego: EgoState) -> float:
        """From the ego to the end of its route [m]."""
        index, s = self._place(ego)
        return self._remaining[index[:2]] + self._road.lane(index).length - s

    def free(self, ego: EgoState) -> float:
        """How far the ego gets on its route without a lane change [m]; inf to its end.

        Where a lane forks inside a junction, SUMO takes the way that leads on, and the others lie over it at first.
        """
        index, s = self._place(ego)
        start, _ = self._joints.get(index, (None, None))
        forks = [joint for joint, (before, _) in self._joints.items() if before == start] or [index]
        return max(self._free[fork] for fork in forks) - s


def _lanes(road: Road, edge: str) -> list[LaneIndex]:
    return [files.lane(edge, number) for number in range(road.count(*files.lane(edge)[:2]))]
