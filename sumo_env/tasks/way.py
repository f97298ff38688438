"""The ego's route on a SUMO network: what is left of it, and how far each of its lanes leads."""

from __future__ import annotations

import math
from collections.abc import Sequence
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
        self._remaining = self._measure(edges)
        self._free = self._follow(edges)
        self.starts = self._check(edges)

    def _measure(self, edges: Sequence[str]) -> dict[tuple[str, str], float]:
        """From the end of each edge and each junction to the end of the route [m], along the shortest lanes."""
        remaining: dict[tuple[str, str], float] = {}
        left = 0.0
        for place in range(len(edges) - 1, -1, -1):
            remaining[files.lane(edges[place])[:2]] = left
            left += min(self._road.lane(index).length for index in _lanes(self._road, edges[place]))
            if place:
                nodes = f"{edges[place - 1]}:to", f"{edges[place]}:from"
                remaining[nodes] = left
                left += min(self._road.lane(index).length for index in self._joints if index[:2] == nodes)
        self._total = left
        return remaining

    def _follow(self, edges: Sequence[str]) -> dict[LaneIndex, float]:
        """From the start of each lane and each joint: how far it leads without a lane change [m]; inf to the end."""
        free: dict[LaneIndex, float] = dict.fromkeys(_lanes(self._road, edges[-1]), math.inf)
        for edge, following in reversed(list(pairwise(edges))):
            nodes = f"{edge}:to", f"{following}:from"
            for joint, (_, end) in self._joints.items():
                if joint[:2] == nodes:
                    free[joint] = self._road.lane(joint).length + free[end]
            for index in _lanes(self._road, edge):
                onward = [free[joint] for joint, (start, _) in self._joints.items() if start == index]
                free[index] = self._road.lane(index).length + max(onward, default=0.0)
        return free

    def _check(self, edges: Sequence[str]) -> tuple[int, ...]:
        """Numbers of the lanes to start in. On edges longer than two zones there is time for a lane change."""
        drivable = set(_lanes(self._road, edges[-1]))
        for edge, following in reversed(list(pairwise(edges))):
            lanes = _lanes(self._road, edge)
            onward = {start for start, end in self._joints.values() if end in drivable}
            if onward.isdisjoint(lanes):
                raise ConfigError(
                    f"ego_route: edge {edge!r} leads to edge {following!r} only in lanes from which the route does "
                    "not go on, and the edge is too short for a lane change"
                )
            if self._road.lane(lanes[0]).length < 2 * self.zone:
                lanes = [index for index in lanes if index in onward]
            drivable = set(lanes)
        if self._total < 2 * self.zone:
            raise ConfigError(
                f"ego_route from edge {edges[0]!r} to edge {edges[-1]!r} is {self._total:.0f} m long; the ego needs "
                f"{2 * self.zone:.0f} m, two seconds at the speed limit"
            )
        return tuple(sorted(number for *_, number in drivable))

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
