"""The lanes of a road and how they hang together: which of them vehicles are on, and who is ahead of and behind whom.

What `idm.strip_neighbours` is on a straight road, on one of bends and joins (``Road.neighbour_vehicles`` of
highway-env with connected lanes). Lanes are rows of a `LaneTable`'s geometry. Distances to who is beyond the end of a
lane are measured along the path (highway-env projects them on the driver's own lane;
`experiments.backends.highway_env_vehicle.PathVehicle`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sumo_env.angles import wrapped
from sumo_env.compiled import borrowing
from sumo_env.models.idm import NEAR
from sumo_env.models.lane_grid import cell, lane_grid
from sumo_env.models.lane_table import (
    LENGTH,
    Floats,
    Integers,
    LaneTable,
    heading_at,
    local_coordinates,
    position,
)
from sumo_env.networks.lanes import VEHICLE_LENGTH


class Net(NamedTuple):
    """The lanes of a road and how they hang together, as arrays. Lanes side by side have successive numbers.

    Attributes:
        geometry: of a `LaneTable`, shape (lanes, columns).
        joined: each lane, then those that follow and those that come before it, padded with -1, shape (lanes, k).
        offsets: where each of these begins, measured on the first [m], shape (lanes, k).
        following: how many of them follow, shape (lanes,).
        first, abreast: first lane of the road that a lane is part of, and number of its lanes, shape (lanes,).
        corner, near: of `lane_grid`: the lanes that vehicles are on by `NEAR`, and on up to their own length before and
            after the ends.
    """

    geometry: Floats
    joined: Integers
    offsets: Floats
    following: Integers
    first: Integers
    abreast: Integers
    corner: Floats
    near: Integers


def net(table: LaneTable) -> Net:
    """The joins of a table of lanes, as ``Road.neighbour_vehicles`` lists them."""
    names = list(table.index)
    roads: dict[tuple[str, str], list[int]] = {}
    for number, (start, end, _) in enumerate(names):
        roads.setdefault((start, end), []).append(number)
    rows: list[list[int]] = []
    for number, (start, _, i) in enumerate(names):
        before = [lanes[i if i < len(lanes) else 0] for (_, end), lanes in roads.items() if end == start]
        rows.append([number, *(int(k) for k in table.successors[number] if k >= 0), *before])
    width = max(map(len, rows))
    length = table.geometry[:, LENGTH]
    following = np.array([int((row >= 0).sum()) for row in table.successors])
    offsets = np.zeros((len(rows), width))
    for number, row in enumerate(rows):
        for k, lane in enumerate(row[1:], start=1):
            offsets[number, k] = length[number] if k <= following[number] else -length[lane]
    of_road = [roads[start, end] for start, end, _ in names]
    return Net(
        table.geometry,
        np.array([row + [-1] * (width - len(row)) for row in rows], dtype=np.int64),
        offsets,
        following.astype(np.int64),
        np.array([lanes[0] for lanes in of_road], dtype=np.int64),
        np.array([len(lanes) for lanes in of_road], dtype=np.int64),
        *lane_grid(table.geometry, VEHICLE_LENGTH, NEAR),
    )


@borrowing
def along(geometry: Floats, s: Floats, x: Floats, y: Floats, i: int, lane: int) -> float:
    """Coordinate s [m] of vehicle `i` along a lane, by `locate` or, if that is not near, found now."""
    if math.isnan(s[i, lane]):
        s[i, lane] = local_coordinates(geometry, lane, x[i], y[i])[0]
    return s[i, lane]


@borrowing
def _far(geometry: Floats, lane: int, s: float, lat: float, heading: float) -> float:
    """Distance [m] and turn [rad] of a vehicle from a lane, added up (``AbstractLane.distance_with_heading``)."""
    angle = heading - heading_at(geometry, lane, s)
    distance = abs(lat) + max(s - geometry[lane, LENGTH], 0.0) + max(-s, 0.0)
    return distance + abs(wrapped(angle))


@borrowing
def _closest_of_all(geometry: Floats, x: float, y: float, heading: float) -> int:
    """``RoadNetwork.get_closest_lane_index`` with heading; of equals the first."""
    best, least = 0, math.inf
    for lane in range(len(geometry)):
        s, lat = local_coordinates(geometry, lane, x, y)
        distance = _far(geometry, lane, s, lat, heading)
        if distance < least:
            best, least = lane, distance
    return best


@borrowing
def locate(
    roads: Net, x: Floats, y: Floats, heading: Floats, lane: Integers, moved: bool, s: Floats, on: NDArray[np.bool_]
) -> None:
    """Write coordinates of the vehicles along the lanes near them [m] into `s`, and whether they are on them into `on`.

    Shapes (n, lanes); beforehand NaN (see `along`) and False. On a lane is meant as in ``AbstractLane.on_lane`` with a
    margin of 1 m. If they have `moved`, `lane`, shape (n,), is given the closest one of each.
    """
    geometry = roads.geometry
    for j in range(len(x)):
        best, least = 0, math.inf
        column, row = cell(roads.corner, roads.near, x[j], y[j])
        for k in range(roads.near.shape[2]):
            number = roads.near[column, row, k]
            if number < 0:
                break
            s[j, number], lat = local_coordinates(geometry, number, x[j], y[j])
            within = -VEHICLE_LENGTH <= s[j, number] < geometry[number, LENGTH] + VEHICLE_LENGTH
            on[j, number] = within and abs(lat) <= NEAR
            if moved:
                distance = _far(geometry, number, s[j, number], lat, heading[j])
                if distance < least:
                    best, least = number, distance
        if moved:  # lanes that are not near are further away than NEAR
            lane[j] = best if least <= NEAR else _closest_of_all(geometry, x[j], y[j], heading[j])


@borrowing
def neighbours(
    i: int, lane: int, roads: Net, s: Floats, on: NDArray[np.bool_], x: Floats, y: Floats
) -> tuple[int, int]:
    """``Road.neighbour_vehicles`` with connected lanes: who is ahead of and behind vehicle `i` on `lane`; -1: nobody.

    A vehicle is looked for on the lane, then on all that follow it, then on all that come before it; the first that
    it is on decides. s, on: of `locate`; x, y [m]: shape (n,).
    """
    front, rear = -1, -1
    s_front, s_rear = math.inf, -math.inf
    s_own = along(roads.geometry, s, x, y, i, lane)
    for j in range(len(s)):
        if j == i:
            continue
        for k in range(roads.joined.shape[1]):
            search = roads.joined[lane, k]
            if search < 0:
                break
            if not on[j, search]:
                continue
            place = s[j, search] + roads.offsets[lane, k]
            if s_own <= place <= s_front:
                s_front, front = place, j
            if s_rear < place < s_own:
                s_rear, rear = place, j
            break
    return front, rear


@borrowing
def way_beyond(
    i: int, j: int, lane: int, target: int, roads: Net, s: Floats, on: NDArray[np.bool_], x: Floats, y: Floats
) -> float:
    """Way of vehicle `i` to vehicle `j` beyond the end of its `lane` [m]; nan if `j` is on its road or not ahead.

    At the end of a lane, where `target` is already on the next road, those that follow the target count as well.
    """
    geometry = roads.geometry
    for own in range(roads.first[lane], roads.first[lane] + roads.abreast[lane]):
        if on[j, own]:
            return math.nan
    for k in range(1, 1 + roads.following[lane]):
        search = roads.joined[lane, k]
        if on[j, search]:
            return s[j, search] - along(geometry, s, x, y, i, lane) + geometry[lane, LENGTH]
    if roads.first[target] != roads.first[lane]:
        for k in range(1 + roads.following[target]):
            search = roads.joined[target, k]
            if on[j, search]:
                beyond = geometry[lane, LENGTH] + roads.offsets[target, k]
                return s[j, search] - along(geometry, s, x, y, i, lane) + beyond
    return math.nan


@borrowing
def next_target(lane: int, following_road: int, roads: Net, x: float, y: float) -> int:
    """``RoadNetwork.next_lane``: the lane of the next road of the way, whose first lane is `following_road`."""
    if roads.abreast[lane] == roads.abreast[following_road]:
        return following_road + lane - roads.first[lane]
    px, py = position(roads.geometry, lane, local_coordinates(roads.geometry, lane, x, y)[0])
    best, least = following_road, math.inf
    for candidate in range(following_road, following_road + roads.abreast[following_road]):
        s, lat = local_coordinates(roads.geometry, candidate, px, py)
        distance = abs(lat) + max(s - roads.geometry[candidate, LENGTH], 0.0) + max(-s, 0.0)
        if distance < least:
            best, least = candidate, distance
    return best
