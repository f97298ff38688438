"""The compiled parts of `accelerate`: lanes as arrays of numbers, and what highway-env does with them.

Where a result is a choice (a lane, a leader, a conflict) everything is compiled. Where it is a number that moves a
vehicle, numpy computes the tangent, the inverse functions and the power between two kernels, because the C library's
differ from numpy's in the last bit: episodes are then those of highway-env to the last bit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from highway_env.road.lane import CircularLane, SineLane, StraightLane
from highway_env.road.road import RoadNetwork

from sumo_env.compiled import compiled
from sumo_env.models import lane_table as columns
from sumo_env.models.lane_table import (
    AMPLITUDE,
    CIRCULAR,
    COS,
    HEADING,
    KIND,
    LENGTH,
    PHASE,
    PULSATION,
    RADIUS,
    SIN,
    SINE,
    START_PHASE,
    STRAIGHT,
    TURN,
    X,
    Y,
    heading_at,
    local_coordinates,
)  # fmt: skip
from sumo_env.networks.roads import LaneIndex

VEHICLE_LENGTH, VEHICLE_WIDTH = 5.0, 2.0  # [m] of Vehicle
NEAR = 3.0  # [m] from the centre line, half a lane's width and a margin of 1 m
PURSUIT = 0.1  # [s] ControlledVehicle.TAU_PURSUIT
KP_HEADING, KP_LATERAL = 1 / 0.2, 1 / 0.6  # [1/s] ControlledVehicle
MOST_STEERING = math.pi / 3  # [rad] ControlledVehicle.MAX_STEERING_ANGLE


@dataclass(frozen=True)
class Lanes:
    """The lanes of a highway-env network; called by their number.

    Attributes:
        names: their names, in the network's order; `index` is the reverse.
        lanes: the lanes themselves.
        geometry: rows of `sumo_env.models.lane_table`, with the numbers of highway-env's lanes.
        road: number of the road that a lane is part of, shape (lanes,).
        following: lanes that a driver sees beyond each lane, shape (lanes, most), padded with -1.
        searched: lanes that ``Road.neighbour_vehicles`` searches for each lane, and where they begin on it
            [m].
    """

    names: list[LaneIndex]
    index: dict[LaneIndex, int]
    lanes: list[Any]
    geometry: Any
    road: Any
    following: Any
    searched: Any
    offsets: Any

    @classmethod
    def of(cls, network: RoadNetwork, connected: bool) -> Lanes:
        """The lanes of a network; `connected`: drivers see beyond the end of their lane."""
        named = network.lanes_dict()
        index = {name: number for number, name in enumerate(named)}
        graph = network.graph
        roads = {ends: number for number, ends in enumerate(dict.fromkeys(name[:2] for name in named))}
        following, searched = [], []
        for name, lane in named.items():
            start, end, i = name
            after = [
                index[end, node, i if i < len(lanes) else 0] for node, lanes in graph.get(end, {}).items()
            ]
            before = [
                (node, start, i if i < len(ends[start]) else 0)
                for node, ends in graph.items()
                if start in ends
            ]
            following.append(after)
            joined = [(number, lane.length) for number in after] + [
                (index[other], -named[other].length) for other in before
            ]
            searched.append([(index[name], 0.0), *(joined if connected else [])])
        return cls(
            list(named), index, list(named.values()), np.array([_row(lane) for lane in named.values()]),
            np.array([roads[name[:2]] for name in named]), padded(following),
            padded([[number for number, _ in row] for row in searched]),
            padded([[offset for _, offset in row] for row in searched], np.float64),
        )  # fmt: skip


def padded(rows: list[list[Any]], dtype: Any = np.int64) -> Any:
    """Rows of unequal length as one array, filled up with -1."""
    width = max(1, *map(len, rows)) if rows else 1
    return np.array([row + [-1] * (width - len(row)) for row in rows], dtype)


def _row(lane: Any) -> Any:
    row = np.zeros(columns.COLUMNS)
    row[[LENGTH, columns.LIMIT, columns.PRIORITY]] = lane.length, lane.speed_limit, lane.priority
    if isinstance(lane, CircularLane):
        row[[KIND, X, Y]] = CIRCULAR, *lane.center
        row[[RADIUS, START_PHASE, TURN]] = lane.radius, lane.start_phase, lane.direction
    elif isinstance(lane, StraightLane):
        row[[KIND, X, Y]] = STRAIGHT, *lane.start
        row[[COS, SIN, HEADING]] = *lane.direction, lane.heading
        if isinstance(lane, SineLane):
            row[KIND] = SINE
            row[[AMPLITUDE, PULSATION, PHASE]] = lane.amplitude, lane.pulsation, lane.phase
    else:
        raise TypeError(f"no table columns for a {type(lane).__name__}")
    return row


# -- choices: rounding does not matter --------------------------------------------------------------------


@compiled
def closest(geometry: Any, x: float, y: float, heading: float) -> int:
    """``RoadNetwork.get_closest_lane_index``: number of the lane; a heading of nan counts nothing."""
    best, best_distance = 0, math.inf
    for lane in range(len(geometry)):
        s, lat = local_coordinates(geometry, lane, x, y)
        distance = abs(lat) + max(s - geometry[lane, LENGTH], 0.0) + max(-s, 0.0)
        if not math.isnan(heading):
            angle = heading - heading_at(geometry, lane, s)
            distance += abs((angle + math.pi) % (2.0 * math.pi) - math.pi)
        if distance < best_distance:
            best, best_distance = lane, distance
    return best


@compiled
def closest_of_all(geometry: Any, x: Any, y: Any, heading: Any) -> Any:
    """`closest` of each vehicle, shape (n,)."""
    lanes = np.empty(len(x), np.int64)
    for i in range(len(x)):
        lanes[i] = closest(geometry, x[i], y[i], heading[i])
    return lanes


@compiled
def after_end(geometry: Any, lanes: Any, x: Any, y: Any) -> Any:
    """``AbstractLane.after_end`` of each vehicle on its lane, shape (n,)."""
    found = np.empty(len(x), np.bool_)
    for i in range(len(x)):
        s = local_coordinates(geometry, lanes[i], x[i], y[i])[0]
        found[i] = s > geometry[lanes[i], LENGTH] - VEHICLE_LENGTH / 2
    return found


@compiled
def on_lane(geometry: Any, lane: int, s: float, lat: float) -> bool:
    """``AbstractLane.on_lane`` with a margin of 1 m."""
    return abs(lat) <= NEAR and -VEHICLE_LENGTH <= s < geometry[lane, LENGTH] + VEHICLE_LENGTH


@compiled
def neighbours(
    geometry: Any, searched: Any, offsets: Any, x: Any, y: Any, i: int, lane: int
) -> tuple[int, int]:
    """``Road.neighbour_vehicles``: rows of the vehicles ahead of and behind row `i` on a lane; -1 for none."""
    front, rear = -1, -1
    s_front, s_rear = math.inf, -math.inf
    s_own = local_coordinates(geometry, lane, x[i], y[i])[0]
    for j in range(len(x)):
        if j == i:
            continue
        for k in range(searched.shape[1]):
            other = searched[lane, k]
            if other < 0:
                break
            s, lat = local_coordinates(geometry, other, x[j], y[j])
            if not on_lane(geometry, other, s, lat):
                continue
            s += offsets[lane, k]
            if s_own <= s <= s_front:
                s_front, front = s, j
            if s_rear < s < s_own:
                s_rear, rear = s, j
            break
    return front, rear


@compiled
def beyond(
    geometry: Any, road: Any, following: Any, lane: int, target: int, x: float, y: float
) -> tuple[int, float]:
    """``distance_beyond``: the lane beyond one's own that a leader at (x, y) is on, and where it begins [m].

    The lane is -1 if the leader is on the vehicle's own road, or on none.
    """
    for own in range(len(road)):
        if road[own] == road[lane]:
            s, lat = local_coordinates(geometry, own, x, y)
            if on_lane(geometry, own, s, lat):
                return -1, 0.0
    length = geometry[lane, LENGTH]
    for step in range(3):  # beyond the own lane, the target lane, beyond that
        if step > 0 and road[target] == road[lane]:
            break
        begin = length + geometry[target, LENGTH] if step == 2 else length
        for k in range(1 if step == 1 else following.shape[1]):
            other = target if step == 1 else following[lane if step == 0 else target, k]
            if other < 0:
                break
            s, lat = local_coordinates(geometry, other, x, y)
            if on_lane(geometry, other, s, lat):
                return other, begin
    return -1, 0.0


@compiled
def leaders(
    geometry: Any, road: Any, following: Any, searched: Any, offsets: Any, x: Any, y: Any, own: Any,
    targets: Any, along_path: Any,
) -> tuple[Any, Any, Any, Any, Any, Any]:  # fmt: skip
    """Whom each vehicle follows: on its own lane, then, if that is another one, on its target lane.

    Returns:
        Of n pairs and n more: row of the leader (-1: none), whether it is beyond the follower's road, and where the
        lane that its place is measured on begins [m], each of shape (2 n,); then what to project on which lane,
        the n vehicles and the 2 n leaders: lane, x and y, each of shape (3 n,).
    """
    n = len(x)
    leader, is_beyond, begin = np.full(2 * n, -1), np.zeros(2 * n, np.bool_), np.zeros(2 * n)
    lane = np.concatenate((own, own, own))
    px, py = np.concatenate((x, x, x)), np.concatenate((y, y, y))
    for i in range(n):
        for k in range(2 if targets[i] != own[i] else 1):
            row = i + k * n
            front = neighbours(geometry, searched, offsets, x, y, i, targets[i] if k else own[i])[0]
            if front < 0:
                continue
            leader[row], px[row + n], py[row + n] = front, x[front], y[front]
            if along_path[i]:
                other, offset = beyond(geometry, road, following, own[i], targets[i], x[front], y[front])
                if other >= 0:
                    is_beyond[row], begin[row], lane[row + n] = True, offset, other
    return leader, is_beyond, begin, lane, px, py


# -- numbers: to the last bit -----------------------------------------------------------------------------


def project(geometry: Any, lanes: Any, x: Any, y: Any) -> tuple[Any, Any]:
    """``AbstractLane.local_coordinates`` (s, lat) of each point on its lane; all of shape (n,)."""
    rows = geometry[lanes]
    return _project(rows, x, y, np.arctan2(y - rows[:, Y], x - rows[:, X]))


@compiled
def _project(rows: Any, x: Any, y: Any, phi: Any) -> tuple[Any, Any]:
    s, lat = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        g = rows[i]
        dx, dy = x[i] - g[X], y[i] - g[Y]
        if g[KIND] == CIRCULAR:
            turned = g[START_PHASE] + ((phi[i] - g[START_PHASE] + math.pi) % (2.0 * math.pi) - math.pi)
            s[i] = g[TURN] * (turned - g[START_PHASE]) * g[RADIUS]
            lat[i] = g[TURN] * (g[RADIUS] - math.sqrt(dx * dx + dy * dy))
        else:
            s[i], lat[i] = dx * g[COS] + dy * g[SIN], dy * g[COS] - dx * g[SIN]
            if g[KIND] == SINE:
                lat[i] -= g[AMPLITUDE] * math.sin(g[PULSATION] * s[i] + g[PHASE])
    return s, lat


@compiled
def not_zero(x: float) -> float:
    """``utils.not_zero``."""
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0 else -1e-2


@compiled
def clip(x: float, low: float, high: float) -> float:
    """``np.clip``."""
    return min(max(x, low), high)


def steering(geometry: Any, lanes: Any, x: Any, y: Any, heading: Any, speed: Any) -> Any:
    """``ControlledVehicle.steering_control``: angles [rad] that lead each vehicle to its lane, shape (n,)."""
    rows = geometry[lanes]
    s, lat = _project(rows, x, y, np.arctan2(y - rows[:, Y], x - rows[:, X]))
    direction, bend, approach = _pursue(rows, s, lat, speed)
    slip = _turn(direction, np.arctan(bend), np.arcsin(approach), heading, speed)
    angle = np.arctan(2 * np.tan(np.arcsin(slip)))
    return np.minimum(np.maximum(angle, -MOST_STEERING), MOST_STEERING)


@compiled
def _pursue(rows: Any, s: Any, lat: Any, speed: Any) -> tuple[Any, Any, Any]:
    direction, bend, approach = np.empty(len(s)), np.zeros(len(s)), np.empty(len(s))
    for i in range(len(s)):
        g = rows[i]
        ahead = s[i] + speed[i] * PURSUIT
        if g[KIND] == CIRCULAR:
            direction[i] = g[TURN] * ahead / g[RADIUS] + g[START_PHASE] + math.pi / 2 * g[TURN]
        else:
            direction[i] = g[HEADING]
            if g[KIND] == SINE:
                bend[i] = g[AMPLITUDE] * g[PULSATION] * math.cos(g[PULSATION] * ahead + g[PHASE])
        approach[i] = clip(-KP_LATERAL * lat[i] / not_zero(speed[i]), -1.0, 1.0)
    return direction, bend, approach


@compiled
def _turn(direction: Any, bend: Any, approach: Any, heading: Any, speed: Any) -> Any:
    slip = np.empty(len(direction))
    for i in range(len(direction)):
        wanted = direction[i] + bend[i] + clip(approach[i], -math.pi / 4, math.pi / 4)
        rate = KP_HEADING * ((wanted - heading[i] + math.pi) % (2 * math.pi) - math.pi)
        slip[i] = clip(VEHICLE_LENGTH / 2 / not_zero(speed[i]) * rate, -1.0, 1.0)
    return slip


@compiled
def speed_ratios(speed: Any, wanted: Any, limit: Any) -> Any:
    """The base of IDM's free term, ``IDMVehicle.acceleration``, shape (n,)."""
    ratio = np.empty(len(speed))
    for i in range(len(speed)):
        ratio[i] = max(speed[i], 0.0) / abs(not_zero(clip(wanted[i], 0.0, limit[i])))
    return ratio


@compiled
def gap_ratios(
    leader: Any, is_beyond: Any, begin: Any, places: Any, heading: Any, speed: Any, min_gap: Any, headway: Any,
    root: Any,
) -> Any:  # fmt: skip
    """The base of IDM's interaction term, of pairs as `leaders` lists them, shape (2 n,); 0 without a leader.

    Args:
        places: where the vehicles and the leaders are on their lanes [m], shape (3 n,).
        root: 2 sqrt(acceleration x deceleration) [m/s2].
    """
    n = len(speed)
    ratio = np.zeros(2 * n)
    for row in range(2 * n):
        j, i = leader[row], row % n
        if j < 0:
            continue
        if is_beyond[row]:
            faster = speed[i] - speed[j]
        else:
            c, s = math.cos(heading[i]), math.sin(heading[i])
            faster = (speed[i] * c - speed[j] * math.cos(heading[j])) * c + (
                speed[i] * s - speed[j] * math.sin(heading[j])
            ) * s
        wanted = min_gap[i] + speed[i] * headway[i] + speed[i] * faster / root[i]
        ratio[row] = wanted / not_zero(places[n + row] - places[i] + begin[row])
    return ratio


@compiled
def behind_both(free: Any, comfort: Any, square: Any, most: Any) -> Any:
    """IDM's acceleration behind the leader on either lane, the lower one, within `most` [m/s2]; shape (n,)."""
    n = len(free)
    result = np.empty(n)
    for i in range(n):
        lower = min(free[i] - comfort[i] * square[i], free[i] - comfort[i] * square[n + i])
        result[i] = clip(lower, -most[i], most[i])
    return result
