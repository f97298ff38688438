"""Lane changes: MOBIL as highway-env has it (``IDMVehicle.change_lane_policy``; Kesting et al. 2007).

A driver looks at the lane to the left and then at the one to the right, at most about once a second, and
changes if
    safety:    the follower on the new lane would not have to brake harder than 2 m/s2, and incentive: the
    driver itself gains at least 0.2 m/s2 (politeness is 0, so that followers' losses do not count).
If both lanes pass, the right one is taken, because it is looked at last. All accelerations, the follower's as
well, are computed with the *deciding* driver's parameters.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sumo_env.cars import (
    ACCELERATION,
    CHANGES,
    CRASHED,
    FORCED,
    HEADING,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIMER,
    Flags,
    X,
    Y,
)
from sumo_env.compiled import borrowing, compiled
from sumo_env.models.idm import A_MAX, S0, TAU, B, behind, desired_gap, strip_accelerations, strip_neighbours
from sumo_env.models.lane_table import Floats, Integers
from sumo_env.networks.lanes import VEHICLE_LENGTH

SAFE_BRAKING = 2.0  # LANE_CHANGE_MAX_BRAKING_IMPOSED [m/s2]
MIN_GAIN = 0.2  # LANE_CHANGE_MIN_ACC_GAIN [m/s2]
DELAY = 1.0  # LANE_CHANGE_DELAY [s]; a decision is due when the driver's timer *exceeds* it
MIN_SPEED = 1.0  # nobody decides to change lane below it [m/s]


@compiled
def closest_lanes(y: Floats, lanes_count: int, lane_width: float) -> Integers:
    """The lane whose centre line, y = lane_width * lane, is nearest to each vehicle; of equals the left."""
    result = np.empty(len(y), dtype=np.int64)
    for i in range(len(y)):
        result[i] = min(max(math.ceil(y[i] / lane_width - 0.5), 0), lanes_count - 1)
    return result


@borrowing
def _between(
    follower: int,
    leader: int,
    drivers: Floats,
    i: int,
    x: Floats,
    speed: Floats,
    heading: Floats,
    target_speed: Floats,
    limit: float,
) -> float:
    """IDM acceleration [m/s2] of `follower` behind `leader` if it drove like driver `i`; -1: there is none."""
    if follower < 0:
        return 0.0
    gap, v_lead = math.inf, 0.0
    if leader >= 0:
        gap = x[leader] - x[follower]
        v_lead = speed[leader] * math.cos(heading[leader] - heading[follower])
    return behind(drivers, i, speed[follower], target_speed[follower], limit, gap, v_lead)


@borrowing
def criteria(
    i: int,
    new_lane: int,
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    lane: Integers,
    target_speed: Floats,
    drivers: Floats,
    lane_width: float,
    length: float,
    limit: float,
) -> tuple[float, float]:
    """MOBIL's criteria for a change of vehicle `i` to `new_lane`: (new follower's acceleration, gain) [m/s2].

    The change is safe if the first is at least -SAFE_BRAKING (it is 0 without a follower) and worth it if the
    second is at least MIN_GAIN. Arguments as in `desired_lanes`.
    """
    preceding, following = strip_neighbours(i, new_lane * lane_width, 1.0, x, y, length)
    old_preceding, _ = strip_neighbours(i, lane[i] * lane_width, 1.0, x, y, length)
    imposed = _between(following, i, drivers, i, x, speed, heading, target_speed, limit)
    after = _between(i, preceding, drivers, i, x, speed, heading, target_speed, limit)
    before = _between(i, old_preceding, drivers, i, x, speed, heading, target_speed, limit)
    return imposed, after - before


@borrowing
def _aborts(
    i: int,
    x: Floats,
    speed: Floats,
    heading: Floats,
    lane: Integers,
    target: Integers,
    drivers: Floats,
) -> bool:
    """Is somebody ahead, closer than vehicle `i` likes and not there yet, changing to the same lane?"""
    for j in range(len(x)):
        if j == i or lane[j] == target[i] or target[j] != target[i]:
            continue
        v_lead = speed[j] * math.cos(heading[j] - heading[i])
        gap = desired_gap(
            speed[i], v_lead, drivers[i, A_MAX], drivers[i, B], drivers[i, S0], drivers[i, TAU]
        )
        if 0.0 < x[j] - x[i] < gap:
            return True
    return False


@compiled
def desired_lanes(
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    lane: Integers,
    target_lane: Integers,
    target_speed: Floats,
    drivers: Floats,
    changes: NDArray[np.bool_],
    due: NDArray[np.bool_],
    lanes_count: int,
    lane_width: float,
    length: float,
    limit: float,
) -> Integers:
    """The lane that each driver now wants to change to, shape (n,); -1 for those who change nothing.

    A driver with ``lane == target_lane`` decides by MOBIL if a decision is due. One that is changing only
    asks whether to give up, which means to go back to `lane`: if another vehicle that is not yet on the
    target lane heads for it too, ahead and closer than the desired gap.

    Drivers are asked one after the other, as in highway-env. The order has no effect on MOBIL, which looks at
    positions and speeds alone, but it has on giving up: there a decision taken earlier in the same call is
    already seen.

    Args:
        x, y, speed, heading: shape (n,) [m, m, m/s, rad]; all vehicles, in highway-env's order (ego first).
        lane, target_lane: number of the lane a vehicle is on and of the one it heads for, 0 the left one,
            shape (n,); also of vehicles that take no decision here.
        target_speed: desired speeds before the limit, shape (n,) [m/s].
        drivers: shape (n, 6), the columns of `idm`.
        changes: who takes decisions here at all (neither the ego nor wrecks), shape (n,).
        due: whose time since the last decision exceeds DELAY, shape (n,). The caller resets it to 0 for those
            with ``changes & due & (lane == target_lane)``.
        lanes_count, lane_width: lane k is centred on y = lane_width * k [m].
        length, limit: of the road, which begins at x = 0 [m], and its speed limit [m/s].
    """
    result = np.full(len(x), -1, dtype=np.int64)
    target = target_lane.copy()
    for i in range(len(x)):
        if not changes[i]:
            continue
        if lane[i] != target[i]:
            if _aborts(i, x, speed, heading, lane, target, drivers):
                result[i] = lane[i]
        elif due[i] and abs(speed[i]) >= MIN_SPEED and 0.0 <= x[i] < length + VEHICLE_LENGTH:
            for new_lane in (lane[i] - 1, lane[i] + 1):
                reachable = abs(y[i] - new_lane * lane_width) <= 2.0 * lane_width
                if not (0 <= new_lane < lanes_count and reachable):
                    continue
                imposed, gain = criteria(
                    i, new_lane, x, y, speed, heading, lane, target_speed, drivers, lane_width, length, limit
                )
                if imposed >= -SAFE_BRAKING and gain >= MIN_GAIN:
                    result[i] = new_lane
        if result[i] >= 0:
            target[i] = result[i]
    return result


@compiled
def drive(
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    crashed: NDArray[np.bool_],
    target_speed: Floats,
    drivers: Floats,
    target: Integers,
    timer: Floats,
    changes: NDArray[np.bool_],
    forced: NDArray[np.bool_],
    lanes_count: int,
    lane_width: float,
    length: float,
    limit: float,
    dt: float,
    acceleration: Floats,
) -> None:
    """One step of MOBIL and IDM.

    Changes in place `target` (by `desired_lanes`), `timer` and `forced` (a change that a risk event began, until the
    lane is reached), and writes `acceleration` [m/s2].

    Args:
        crashed, changes, forced: shape (n,); other arrays and numbers as in `desired_lanes`.
        dt: length of the step [s].
    """
    n = len(x)
    lane = closest_lanes(y, lanes_count, lane_width)
    decides, due = np.empty(n, np.bool_), np.empty(n, np.bool_)
    any_decision = False
    for i in range(n):
        forced[i] = forced[i] and lane[i] != target[i]
        decides[i] = changes[i] and not crashed[i] and not forced[i]
        due[i] = decides[i] and timer[i] > DELAY
        any_decision = any_decision or due[i] or (decides[i] and lane[i] != target[i])
    if any_decision:
        wanted = desired_lanes(
            x, y, speed, heading, lane, target, target_speed, drivers,
            decides, due, lanes_count, lane_width, length, limit,
        )  # fmt: skip
        for i in range(n):
            if due[i] and lane[i] == target[i]:
                timer[i] = 0.0
        for i in range(n):
            if wanted[i] >= 0:
                target[i] = wanted[i]
    lane_y, target_y = np.empty(n), np.empty(n)
    for i in range(n):
        timer[i] += dt
        lane_y[i], target_y[i] = lane_width * lane[i], lane_width * target[i]
    acceleration[:] = strip_accelerations(
        x, y, speed, heading, lane_y, target_y, np.ones(n), target_speed, drivers, length, limit
    )


@compiled
def act(
    floats: Floats,
    integers: Integers,
    flags: Flags,
    drivers: Floats,
    lanes_count: int,
    lane_width: float,
    length: float,
    limit: float,
    dt: float,
) -> None:
    """`drive` with the matrices of `cars.Cars`; lanes are numbered from the left."""
    drive(
        floats[X], floats[Y], floats[SPEED], floats[HEADING], flags[CRASHED], floats[TARGET_SPEED], drivers,
        integers[TARGET], floats[TIMER], flags[CHANGES], flags[FORCED], lanes_count, lane_width, length, limit, dt,
        floats[ACCELERATION],
    )  # fmt: skip
