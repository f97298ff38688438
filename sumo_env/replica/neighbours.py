"""Who is ahead of and behind whom (``Road.neighbour_vehicles``), and how far beyond the end of a lane a leader is."""

import math
from typing import Any

from sumo_env.replica.compiled import inlined
from sumo_env.replica.geometry import is_on
from sumo_env.replica.tables import NONE


@inlined
def is_car_on(lanes: Any, places: Any, lane: int, j: int) -> bool:
    """Is car `j` on this lane, by a margin of 1 m?"""
    return is_on(lanes[lane], places.s[lane, j], places.lat[lane, j])


@inlined
def sort_lane(lanes: Any, places: Any, lane: int) -> None:
    """Find the cars that a driver sees on a lane and on those joined to it, and sort them along the lane."""
    joined, offset = lanes[lane].joined, lanes[lane].offset
    order, seen = places.order[lane], places.seen[lane]
    count = 0
    for j in range(len(order)):
        for k in range(len(joined)):
            if joined[k] == NONE:
                break
            if is_car_on(lanes, places, joined[k], j):
                s, place = places.s[joined[k], j] + offset[k], count
                while place > 0 and seen[place - 1] > s:  # cars stand nearly in order
                    order[place], seen[place] = order[place - 1], seen[place - 1]
                    place -= 1
                order[place], seen[place] = j, s
                count += 1
                break
    places.count[lane] = count


@inlined
def neighbours(lanes: Any, places: Any, i: int, lane: int) -> tuple[int, int]:
    """The cars next ahead of and behind car `i` on a lane, NONE where there is nobody.

    Of cars at the same place, highway-env's search finds the last one ahead and the first one behind.
    """
    if places.count[lane] == NONE:
        sort_lane(lanes, places, lane)
    s, count = places.s[lane, i], places.count[lane]
    first, end = 0, count  # of the cars at `s` or ahead
    while first < end:
        middle = (first + end) >> 1
        if places.seen[lane, middle] < s:
            first = middle + 1
        else:
            end = middle
    front, rear, place = NONE, NONE, 0.0
    for k in range(first, count):
        if places.order[lane, k] != i:
            if front != NONE and places.seen[lane, k] > place:
                break
            front, place = places.order[lane, k], places.seen[lane, k]
    for k in range(first - 1, -1, -1):
        if places.order[lane, k] != i:
            if rear != NONE and places.seen[lane, k] < place:
                break
            rear, place = places.order[lane, k], places.seen[lane, k]
    return front, rear


@inlined
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
            return places.s[own.joined[k], j] - places.s[lane, i] + own.length
    aim = lanes[target]
    if aim.road != own.road:
        for k in range(1 + aim.following):
            if is_car_on(lanes, places, aim.joined[k], j):
                return places.s[aim.joined[k], j] - places.s[lane, i] + (own.length + aim.offset[k])
    return math.nan
