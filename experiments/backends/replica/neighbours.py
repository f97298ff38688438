"""Who is ahead of and behind whom (``Road.neighbour_vehicles``), and how far beyond the end of a lane a leader is."""

from __future__ import annotations

import math
from typing import Any

from experiments.backends.replica.compiled import compiled
from experiments.backends.replica.geometry import LAT, SEEN, S, is_on
from experiments.backends.replica.tables import NONE


@compiled
def is_car_on(lanes: Any, places: Any, lane: int, j: int) -> bool:
    """Is car `j` on this lane, by a margin of 1 m?"""
    return is_on(lanes[lane], places[S, lane, j], places[LAT, lane, j])


@compiled
def look(lanes: Any, places: Any, lane: int) -> None:
    """Write where a driver sees the cars on a lane and on those joined to it, along the lane [m]; NaN of the others.

    Until somebody has looked, the first of these numbers is inf.
    """
    joined, offset = lanes[lane].joined, lanes[lane].offset
    for j in range(places.shape[2]):
        places[SEEN, lane, j] = math.nan
        for k in range(len(joined)):
            if joined[k] == NONE:
                break
            if is_car_on(lanes, places, joined[k], j):
                places[SEEN, lane, j] = places[S, joined[k], j] + offset[k]
                break


@compiled
def neighbours(lanes: Any, places: Any, i: int, lane: int) -> tuple[int, int]:
    """The cars next ahead of and behind car `i` on a lane, NONE where there is nobody."""
    if places[SEEN, lane, 0] == math.inf:
        look(lanes, places, lane)
    front, rear = NONE, NONE
    s_own, s_front, s_rear = places[S, lane, i], math.inf, -math.inf
    for j in range(places.shape[2]):
        s = places[SEEN, lane, j]
        if s_own <= s <= s_front and j != i:
            s_front, front = s, j
        elif s_rear < s < s_own and j != i:
            s_rear, rear = s, j
    return front, rear


@compiled
def distance_beyond(lanes: Any, places: Any, lane: int, target: int, i: int, j: int) -> float:
    """Way of car `i` to car `j` beyond the end of its `lane` [m]; NaN if `j` is on its own road, or on none.

    ``experiments.backends.highway_env_vehicle.distance_beyond``. Where `target`, the lane that car `i` steers for, is
    on the next road already, the lanes that follow it count as well.
    """
    own = lanes[lane]
    for beside in range(own.road, own.road + own.abreast):
        if is_car_on(lanes, places, beside, j):
            return math.nan
    for k in range(1, 1 + own.following):
        if is_car_on(lanes, places, own.joined[k], j):
            return places[S, own.joined[k], j] - places[S, lane, i] + own.length
    aim = lanes[target]
    if aim.road != own.road:
        for k in range(1 + aim.following):
            if is_car_on(lanes, places, aim.joined[k], j):
                return places[S, aim.joined[k], j] - places[S, lane, i] + (own.length + aim.offset[k])
    return math.nan
