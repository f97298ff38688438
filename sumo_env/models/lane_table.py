"""Lanes as arrays of numbers, and compiled functions of them.

A lane is a row of `geometry` (columns below) and is called by its number; `successors` lists the lanes that
begin where it ends. A vehicle's way is a row of `routes`: the numbers of the lanes it drives along, -1 after
the last, and `stage` says on which of them its centre is. Points are given in highway-env's coordinates (x
east, y down); a lane's own coordinates (s, lat) are metres along its centre line and to the right of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sumo_env.angles import wrapped
from sumo_env.compiled import borrowing
from sumo_env.networks.lanes import VEHICLE_LENGTH, CircularLane, Lane, SineLane, StraightLane
from sumo_env.networks.roads import Road

LaneIndex = tuple[str, str, int]
Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Columns of `geometry`.
KIND, LENGTH, LIMIT, PRIORITY = 0, 1, 2, 3  # one of the kinds below; [m]; [m/s]; the larger has right of way
X, Y = 4, 5  # start of a straight or sine lane, centre of a circular one [m]
COS, SIN, HEADING = 6, 7, 8  # of the axis of a straight or sine lane [rad]
AMPLITUDE, PULSATION, PHASE = 9, 10, 11  # of a sine lane [m, rad/m, rad]
RADIUS, START_PHASE, TURN = 6, 7, 8  # of a circular lane [m, rad], +1 clockwise (to the right) or -1
COLUMNS = 12

STRAIGHT, SINE, CIRCULAR = 0.0, 1.0, 2.0
CLOSE = 1e-6  # [m]


@dataclass(frozen=True, slots=True)
class LaneTable:
    """The lanes of a road.

    Attributes:
        index: number of each lane, by highway-env's name of it.
        names: the names by number.
        geometry: one row a lane, shape (lanes, COLUMNS).
        successors: numbers of the lanes that follow each lane, shape (lanes, most successors), padded with
            -1.
    """

    index: dict[LaneIndex, int]
    names: tuple[LaneIndex, ...]
    geometry: Floats
    successors: Integers

    def route(self, lanes: Iterable[LaneIndex], size: int = 3) -> Integers:
        """A row of `routes`: the numbers of these lanes, shape (size,), padded with -1."""
        numbers = [self.index[lane] for lane in lanes]
        if not 0 < len(numbers) <= size:
            raise ValueError(f"a route has 1 to {size} lanes here, got {len(numbers)}")
        return np.array(numbers + [-1] * (size - len(numbers)), dtype=np.int64)


def lane_table(lanes: Mapping[LaneIndex, Lane]) -> LaneTable:
    """Tabulate the lanes of a road, in their order (for example ``sumo_env.networks.roads.intersection().lanes``).

    Onto each road that begins at its end, a lane is followed by the lane of the same id, or by lane 0 where
    there is none (``Road.neighbour_vehicles`` of highway-env, with connected lanes).
    """
    index = {name: number for number, name in enumerate(lanes)}
    followers: list[list[int]] = []
    for _, node, lane_id in lanes:
        ends = dict.fromkeys(end for start, end, _ in lanes if start == node)
        followers.append([index.get((node, end, lane_id), index[node, end, 0]) for end in ends])
    width = max(1, *map(len, followers)) if followers else 1
    return LaneTable(
        index,
        tuple(lanes),
        np.array([_row(lane) for lane in lanes.values()]),
        np.array([row + [-1] * (width - len(row)) for row in followers], dtype=np.int64),
    )


@lru_cache(maxsize=8)
def compiled_lanes(road: Road) -> LaneTable:
    """The lanes of a road, tabulated once."""
    return lane_table(road.lanes)


def _row(lane: Lane) -> Floats:
    row = np.zeros(COLUMNS)
    row[[LENGTH, LIMIT, PRIORITY]] = lane.length, lane.speed_limit, lane.priority
    if isinstance(lane, CircularLane):
        row[[KIND, X, Y]] = CIRCULAR, *lane.center
        row[[RADIUS, START_PHASE, TURN]] = lane.radius, lane.start_phase, 1.0 if lane.clockwise else -1.0
    elif isinstance(lane, StraightLane):
        row[[KIND, X, Y]] = STRAIGHT, *lane.start
        row[[COS, SIN, HEADING]] = math.cos(lane.heading), math.sin(lane.heading), lane.heading
        if isinstance(lane, SineLane):
            row[KIND] = SINE
            row[[AMPLITUDE, PULSATION, PHASE]] = lane.amplitude, lane.pulsation, lane.phase
    else:
        raise TypeError(f"no table columns for a {type(lane).__name__}")
    return row


# What is read often is read by its number in the table: a row of its own costs more than what is done with it, because
# compiled code counts the references to arrays.


@borrowing
def position(geometry: Floats, lane: int, s: float) -> tuple[float, float]:
    """World position (x, y) [m] of the point `s` [m] along a lane's centre line."""
    x, y = geometry[lane, X], geometry[lane, Y]
    if geometry[lane, KIND] == CIRCULAR:
        radius = geometry[lane, RADIUS]
        phi = geometry[lane, TURN] * s / radius + geometry[lane, START_PHASE]
        return x + radius * math.cos(phi), y + radius * math.sin(phi)
    lat = _wave(geometry, lane, s) if geometry[lane, KIND] == SINE else 0.0
    cos, sin = geometry[lane, COS], geometry[lane, SIN]
    return x + s * cos - lat * sin, y + s * sin + lat * cos


@borrowing
def _wave(geometry: Floats, lane: int, s: float) -> float:
    """How far a waving lane is to the right of its axis [m]."""
    return geometry[lane, AMPLITUDE] * math.sin(geometry[lane, PULSATION] * s + geometry[lane, PHASE])


@borrowing
def heading_at(geometry: Floats, lane: int, s: float) -> float:
    """Heading [rad] of a lane's centre line at `s` [m]; not wrapped."""
    if geometry[lane, KIND] == CIRCULAR:
        turned = s / geometry[lane, RADIUS] + math.pi / 2
        return geometry[lane, TURN] * turned + geometry[lane, START_PHASE]
    if geometry[lane, KIND] == SINE:
        steepest, pulsation = geometry[lane, AMPLITUDE] * geometry[lane, PULSATION], geometry[lane, PULSATION]
        return geometry[lane, HEADING] + math.atan(steepest * math.cos(pulsation * s + geometry[lane, PHASE]))
    return geometry[lane, HEADING]


@borrowing
def direction_at(geometry: Floats, lane: int, x: float, y: float) -> tuple[float, float]:
    """Cosine and sine of the heading of a lane beside the point (x, y) [m]."""
    if geometry[lane, KIND] == STRAIGHT:
        return geometry[lane, COS], geometry[lane, SIN]
    heading = heading_at(geometry, lane, local_coordinates(geometry, lane, x, y)[0])
    return math.cos(heading), math.sin(heading)


@borrowing
def local_coordinates(geometry: Floats, lane: int, x: float, y: float) -> tuple[float, float]:
    """Coordinates (s, lat) [m] on a lane of the world position (x, y) [m]."""
    dx, dy = x - geometry[lane, X], y - geometry[lane, Y]
    if geometry[lane, KIND] == CIRCULAR:
        radius, turn = geometry[lane, RADIUS], geometry[lane, TURN]
        turned = wrapped(math.atan2(dy, dx) - geometry[lane, START_PHASE])
        return turn * turned * radius, turn * (radius - math.sqrt(dx * dx + dy * dy))
    cos, sin = geometry[lane, COS], geometry[lane, SIN]
    s, lat = dx * cos + dy * sin, dy * cos - dx * sin
    if geometry[lane, KIND] == SINE:
        lat -= _wave(geometry, lane, s)
    return s, lat


@borrowing
def closest_lane(geometry: Floats, x: float, y: float, heading: float) -> int:
    """Number of the lane with the least distance and turn (`Road.closest_lane`); -1 if others are as close.

    "As close" is within CLOSE: a tie is decided by the last bits, which are another matter here than on a road.
    """
    best, least, second = -1, math.inf, math.inf
    for lane in range(len(geometry)):
        s, lat = local_coordinates(geometry, lane, x, y)
        distance = abs(lat) + max(s - geometry[lane, LENGTH], 0.0) + max(-s, 0.0)
        if distance > second:
            continue
        distance += abs(wrapped(heading - heading_at(geometry, lane, s)))
        if distance < least:
            best, least, second = lane, distance, least
        elif distance < second:
            second = distance
    return best if second - least > CLOSE else -1


def lane_at(road: Road, x: float, y: float, heading: float) -> LaneIndex:
    """``road.closest_lane``, which is asked itself only where it is a tie."""
    table = compiled_lanes(road)
    number = closest_lane(table.geometry, x, y, heading)
    return table.names[number] if number >= 0 else road.closest_lane(x, y, heading)


@borrowing
def advance(geometry: Floats, routes: Integers, stage: Integers, x: Floats, y: Floats) -> None:
    """Move each vehicle's `stage`, in place, on to the lane of its route that its centre has reached.

    Shapes: routes (n, lanes of a route), stage, x, y (n,). A vehicle beyond its route's last lane stays on
    it.
    """
    for i in range(len(stage)):
        while stage[i] + 1 < routes.shape[1] and routes[i, stage[i] + 1] >= 0:
            lane = routes[i, stage[i]]
            if local_coordinates(geometry, lane, x[i], y[i])[0] <= geometry[lane, LENGTH]:
                break
            stage[i] += 1


@borrowing
def target_stage(geometry: Floats, routes: Integers, stage: Integers, i: int, s: float) -> int:
    """Stage of the lane that vehicle `i`, at `s` [m] on its own, steers for: the next one 2.5 m early.

    ``ControlledVehicle.follow_road`` of highway-env, with ``AbstractLane.after_end``.
    """
    following = stage[i] + 1
    near_end = s > geometry[routes[i, stage[i]], LENGTH] - VEHICLE_LENGTH / 2
    if near_end and following < routes.shape[1] and routes[i, following] >= 0:
        return following
    return stage[i]
