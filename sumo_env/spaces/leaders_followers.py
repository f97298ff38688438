"""What the agent sees, lane by lane: gaps and speeds of the leader and the follower."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces

from sumo_env.config import ConfigError, one_of
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import (
    CLOSING,
    MAX_SPEED,
    NOBODY,
    ON_ITS_WAY,
    ON_REQUEST,
    PERCEPTION_DISTANCE,
    SECONDS_LEFT,
    Neighbour,
    Scene,
)
from sumo_env.spaces.actions import Situation
from sumo_env.spaces.observation import Array, on_its_way

MARGIN = 1.0  # [m] beside a lane, where a vehicle still counts (``Road.neighbour_vehicles``)
LONGEST = 60.0  # [s] that a traffic light is seen to last
# Of features that are not distances.
SCALES = {"light": 2.0, SECONDS_LEFT: LONGEST, **dict.fromkeys((*CLOSING, *ON_REQUEST[2:]), MAX_SPEED)}


class LeadersFollowers:
    """The ego's speed; then for the left, the own and the right lane five numbers; then `features`; float32, flat.

    The five: whether there is such a lane (on a network of one's own: to which the ego may change), gap to the leader
    [m], its speed less the ego's [m/s], and likewise of the follower. Gaps are those between bumpers, 200 m where
    nobody is. Normalized, gaps and speeds are divided by 200 m and 40 m/s. All is clipped.
    """

    def __init__(self, config: Mapping[str, Any], *, on_its_way: bool) -> None:
        """on_its_way: whether there are features of the ego's way. Raises ConfigError: an unknown feature."""
        given = config.get("features") or ()
        if given and not on_its_way:
            raise ConfigError("'LeadersFollowers' has 'features' on networks of your own alone")
        known = (*ON_ITS_WAY, *ON_REQUEST)
        self.features = tuple(one_of("observation feature", feature, known) for feature in given)
        scale = [MAX_SPEED, *(1.0, PERCEPTION_DISTANCE, MAX_SPEED, PERCEPTION_DISTANCE, MAX_SPEED) * 3]
        scale += [SCALES.get(feature, PERCEPTION_DISTANCE) for feature in self.features]
        self._most = np.array(scale)
        self._scale = self._most if config.get("normalize", True) else np.ones(len(scale))
        most = (self._most / self._scale).astype(np.float32)
        self.space = spaces.Box(-most, most, dtype=np.float32)

    def observe(self, seen: Situation) -> Array:
        """The numbers."""
        scene, road, ego = seen[:3]
        exist = [road.beside(ego.lane, -1) is not None, True, road.beside(ego.lane, 1) is not None]
        if scene.place is not None:
            exist, neighbours = [scene.place.left, True, scene.place.right], scene.place.neighbours
        else:
            neighbours = neighbours_on(scene, road, ego.lane)
        values = [ego.speed]
        for side, exists in enumerate(exist):
            values.append(float(exists))
            for neighbour in neighbours[2 * side : 2 * side + 2]:
                nobody = not exists or neighbour.gap > PERCEPTION_DISTANCE
                values += (
                    [PERCEPTION_DISTANCE, 0.0] if nobody else [neighbour.gap, neighbour.speed - ego.speed]
                )
        if self.features:
            known = on_its_way(scene)
            values += [known[feature] for feature in self.features]
        return (np.clip(values, -self._most, self._most) / self._scale).astype(np.float32)


def neighbours_on(scene: Scene, road: Road, lane: LaneIndex) -> tuple[Neighbour, ...]:
    """Leader and follower in the lane to the left, in this one and in that to the right, by the lanes' geometry.

    As ``Road.neighbour_vehicles`` of highway-env, for which a lane ends where the road does.
    """
    start, end, own = lane
    own_half, found = scene.size(scene.ids[0])[0] / 2.0, []
    for place in (own - 1, own, own + 1):
        leader = follower = NOBODY
        if 0 <= place < road.count(start, end):
            geometry = road.lane((start, end, place))
            here, _ = geometry.local_coordinates(scene.x.item(0), scene.y.item(0))
            for row in range(1, len(scene)):
                s, lateral = geometry.local_coordinates(scene.x.item(row), scene.y.item(row))
                if not geometry.covers(s, lateral, MARGIN):
                    continue
                name = scene.ids[row]
                gap = abs(s - here) - own_half - scene.size(name)[0] / 2.0
                along = scene.speed.item(row) * math.cos(scene.heading.item(row) - geometry.heading_at(s))
                if s >= here and gap < leader.gap:
                    leader = Neighbour(name, gap, along)
                elif s < here and gap < follower.gap:
                    follower = Neighbour(name, gap, along)
        found += [leader, follower]
    return tuple(found)
