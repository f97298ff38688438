"""Car following: the Intelligent Driver Model as highway-env has it (``IDMVehicle``; Treiber et al. 2000).

    a = A (1 - (v / v0)^delta - (d* / d)^2),    d* = d0 + v T + v (v - v_lead) / (2 sqrt(A B))

with three properties that matter: d is the distance of *centres*, so d0 holds a vehicle's length; d* is not
floored, so a much faster leader brakes its follower; and a leader is whoever is near the centre line of the
lane, whatever its heading, so that oncoming and crossing cars are leaders too.

Two searches for the leader: `strip_accelerations` on a straight road of parallel lanes, `accelerations_along`
a path on a network. Drivers are rows of a table, shape (n, 6), with the columns below; `driver_row` makes one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from sumo_env.cars import ACCELERATION, HEADING, SPEED, TARGET_SPEED, X, Y
from sumo_env.compiled import borrowing, compiled
from sumo_env.drivers import Driver
from sumo_env.models.lane_table import LENGTH, LIMIT, Floats, Integers, target_stage
from sumo_env.networks.lanes import VEHICLE_LENGTH, WIDTH

# Columns of a table of drivers.
A_MAX = 0  # A, comfortable acceleration [m/s2]
B = 1  # comfortable deceleration, positive [m/s2]
S0 = 2  # d0, distance of centres in a jam [m]
TAU = 3  # T, desired time gap [s]
DELTA = 4  # exponent []
ACC_MAX = 5  # what is commanded is clipped to +- this [m/s2]

NEAR = WIDTH / 2 + 1.0  # [m] from a lane's centre line: who is nearer counts as being on that lane
SMALL = 0.01  # least absolute value of a denominator (highway_env.utils.not_zero)


def driver_rows(drivers: Iterable[Driver]) -> Floats:
    """The table of these drivers, shape (n, 6)."""
    return np.array(
        [(d.accel, d.decel, d.min_gap + VEHICLE_LENGTH, d.tau, d.delta, d.emergency_decel) for d in drivers]
    ).reshape(-1, 6)


def driver_row(driver: Driver) -> Floats:
    """The row of a driver in the table of drivers, shape (6,)."""
    row: Floats = driver_rows([driver])[0]
    return row


@borrowing
def desired_gap(v: float, v_lead: float, a_max: float, b: float, s0_centre: float, tau: float) -> float:
    """d*, the distance of centres [m] wanted at speed `v` behind a leader that drives at `v_lead` [m/s]."""
    return s0_centre + v * tau + v * (v - v_lead) / (2.0 * math.sqrt(a_max * b))


@borrowing
def acceleration(
    v: float,
    v0: float,
    delta: float,
    gap_centre: float,
    v_lead: float,
    a_max: float,
    b: float,
    s0_centre: float,
    tau: float,
) -> float:
    """``IDMVehicle.acceleration`` [m/s2], not clipped (MOBIL compares such values).

    Args:
        v, v0: speed and desired speed, the latter already within the lane's limit [m/s].
        delta: exponent of the free-road term.
        gap_centre: distance of centres to the leader [m], inf without one.
        v_lead: the leader's speed along the follower's heading [m/s], of no effect without one.
        a_max, b: comfortable acceleration and deceleration, both positive [m/s2].
        s0_centre: distance of centres in a jam [m].
        tau: desired time gap [s].
    """
    v0 = max(v0, SMALL)
    result = a_max * (1.0 - (max(v, 0.0) / v0) ** delta)
    if gap_centre < math.inf:
        if abs(gap_centre) <= SMALL:
            gap_centre = SMALL if gap_centre >= 0.0 else -SMALL
        result -= a_max * (desired_gap(v, v_lead, a_max, b, s0_centre, tau) / gap_centre) ** 2
    return result


@borrowing
def behind(
    drivers: Floats, i: int, v: float, target_speed: float, limit: float, gap_centre: float, v_lead: float
) -> float:
    """`acceleration` of row `i` of the table of drivers; `target_speed` is taken within 0 and `limit` [m/s]."""
    v0 = min(max(target_speed, 0.0), limit)
    return acceleration(
        v, v0, drivers[i, DELTA], gap_centre, v_lead, drivers[i, A_MAX], drivers[i, B], drivers[i, S0],
        drivers[i, TAU],
    )  # fmt: skip


@borrowing
def strip_neighbours(
    i: int, centre: float, direction: float, x: Floats, y: Floats, length: float
) -> tuple[int, int]:
    """The vehicles next ahead of and behind vehicle `i` on one lane of a straight road; -1 for none.

    ``Road.neighbour_vehicles`` without connected lanes. The lane runs from x = 0 to `length` or, with
    direction -1, the other way, along y = `centre` [m]; it reaches one vehicle length beyond its ends.
    """
    front, rear = -1, -1
    s_front, s_rear = math.inf, -math.inf
    s_i = x[i] if direction > 0.0 else length - x[i]
    for j in range(len(x)):
        if j == i or abs(y[j] - centre) > NEAR:
            continue
        s = x[j] if direction > 0.0 else length - x[j]
        if not -VEHICLE_LENGTH <= s < length + VEHICLE_LENGTH:
            continue
        if s_i <= s <= s_front:
            s_front, front = s, j
        elif s_rear < s < s_i:
            s_rear, rear = s, j
    return front, rear


@compiled
def strip_accelerations(
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    lane_y: Floats,
    target_y: Floats,
    direction: Floats,
    target_speed: Floats,
    drivers: Floats,
    length: float,
    limit: float,
) -> Floats:
    """What ``IDMVehicle.act`` commands every vehicle on a straight road [m/s2], shape (n,).

    Args:
        x, y, speed, heading: shape (n,) [m, m, m/s, rad].
        lane_y, target_y: centre line of the vehicle's lane and of the one it changes to, else the same [m].
            While changing, the smaller of the accelerations behind either lane's leader is taken.
        direction: +1.0 on a lane to the east, -1.0 to the west. Lanes of both may share a centre line.
        target_speed: desired speeds, before the limit [m/s].
        drivers: shape (n, 6).
        length: of the road, which begins at x = 0 [m].
        limit: speed limit [m/s].
    """
    result = np.empty(len(x))
    for i in range(len(x)):
        a = math.inf
        for k in range(2):
            centre = lane_y[i] if k == 0 else target_y[i]
            if k == 1 and centre == lane_y[i]:
                break
            leader = strip_neighbours(i, centre, direction[i], x, y, length)[0]
            gap, v_lead = math.inf, 0.0
            if leader >= 0:
                gap = direction[i] * (x[leader] - x[i])
                v_lead = speed[leader] * math.cos(heading[leader] - heading[i])
            a = min(a, behind(drivers, i, speed[i], target_speed[i], limit, gap, v_lead))
        result[i] = min(max(a, -drivers[i, ACC_MAX]), drivers[i, ACC_MAX])
    return result


@compiled
def act_on_strip(floats: Floats, sides: Floats, drivers: Floats, length: float, limit: float) -> None:
    """`strip_accelerations` on the two-way road, of the cars in `floats` (`cars.Cars`) into ACCELERATION.

    sides: `lane_y`, which is written here, `target_y` and `direction` of each car, shape (3, n).
    """
    lane_y, target_y, direction = sides
    for i in range(len(lane_y)):
        lane_y[i] = WIDTH if floats[Y, i] >= WIDTH / 2 else 0.0
    floats[ACCELERATION] = strip_accelerations(
        floats[X], floats[Y], floats[SPEED], floats[HEADING], lane_y, target_y, direction, floats[TARGET_SPEED],
        drivers, length, limit,
    )  # fmt: skip


@borrowing
def _path_leader(
    i: int,
    lane: int,
    s_i: float,
    geometry: Floats,
    successors: Integers,
    s: Floats,
    lat: Floats,
) -> tuple[int, float, bool]:
    """The leader of vehicle `i` on `lane`, its distance along the path [m], and whether it is beyond it.

    ``Road.neighbour_vehicles`` with connected lanes: a vehicle is looked for on the lane and then on *each*
    lane that follows it, not only on the one that is on the route; the first that it is on decides. `s`,
    `lat`: coordinates of every vehicle on every lane, shape (n, lanes); `s_i`: of vehicle `i` on `lane`.
    """
    leader, nearest, beyond = -1, math.inf, False
    for j in range(len(s)):
        if j == i:
            continue
        for k in range(-1, successors.shape[1]):
            search = lane if k < 0 else successors[lane, k]
            if search < 0:
                break
            within = -VEHICLE_LENGTH <= s[j, search] < geometry[search, LENGTH] + VEHICLE_LENGTH
            if within and abs(lat[j, search]) <= NEAR:
                s_j = s[j, search] + (0.0 if k < 0 else geometry[lane, LENGTH])
                if s_i <= s_j <= nearest:
                    leader, nearest, beyond = j, s_j, k >= 0
                break
    return leader, nearest - s_i, beyond


@compiled
def accelerations_along(
    geometry: Floats,
    successors: Integers,
    routes: Integers,
    stage: Integers,
    s: Floats,
    lat: Floats,
    speed: Floats,
    heading: Floats,
    target_speed: Floats,
    drivers: Floats,
) -> Floats:
    """What ``IDMVehicle.act`` commands every vehicle on a road network [m/s2], shape (n,).

    The variant ``path`` of highway-env with connected lanes: the distance to a leader beyond the end of one's
    lane is measured along the path, and its speed counts in full. (highway-env projects both on the
    follower's lane and heading, so that cars brake for nothing before a bend.) A leader on the lane itself,
    which a crossing car may be, is treated as in highway-env: with the component of its velocity along the
    follower's heading. On the last half vehicle length of a lane the next lane of the route, and those that
    follow it, are looked at too.

    Args:
        geometry, successors: of a `LaneTable`.
        routes, stage: shapes (n, lanes of a route) and (n,); call `advance` first.
        s, lat: coordinates of the vehicles on the lanes [m], shape (n, lanes). They have to be there for a
            vehicle's own lane and for those that it is on; elsewhere `s` may be inf.
        speed, heading, target_speed: shape (n,) [m/s, rad, m/s].
        drivers: shape (n, 6).
    """
    n = len(s)
    result = np.empty(n)
    for i in range(n):
        own = routes[i, stage[i]]
        target = target_stage(geometry, routes, stage, i, s[i, own])
        a = math.inf
        for k in range(stage[i], target + 1):
            lane = routes[i, k]
            s_i = s[i, own] if k == stage[i] else s[i, own] - geometry[own, LENGTH]
            leader, gap, beyond = _path_leader(i, lane, s_i, geometry, successors, s, lat)
            v_lead = 0.0
            if leader >= 0:
                v_lead = speed[leader]
                if k == stage[i] and not beyond:
                    v_lead *= math.cos(heading[leader] - heading[i])
            a = min(a, behind(drivers, i, speed[i], target_speed[i], geometry[own, LIMIT], gap, v_lead))
        result[i] = min(max(a, -drivers[i, ACC_MAX]), drivers[i, ACC_MAX])
    return result
