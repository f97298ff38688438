"""Drivers on a road of bends and joins: highway-env's ``IDMVehicle.act`` with connected lanes, variant ``path``.

What `idm.strip_accelerations` and `mobil` are on a straight road: following the way, MOBIL with its abort rule and
its condition on planned lanes, and IDM behind the leaders of the lane that a driver is on and of the one it steers
for. Every driver is asked in turn, as in highway-env, so that a decision is seen by those who come after it.

Lanes are those of a `lane_net.Net`.
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
    LEG,
    ON,
    PLANNED,
    SPEED,
    TARGET,
    TARGET_SPEED,
    TIMER,
    Flags,
    X,
    Y,
)
from sumo_env.compiled import borrowing, compiled
from sumo_env.models.idm import A_MAX, ACC_MAX, S0, TAU, B, behind, desired_gap
from sumo_env.models.lane_net import Net, along, locate, neighbours, next_target, way_beyond
from sumo_env.models.lane_table import (
    LENGTH,
    LIMIT,
    Floats,
    Integers,
    local_coordinates,
)
from sumo_env.models.mobil import DELAY, MIN_GAIN, MIN_SPEED, SAFE_BRAKING
from sumo_env.networks.lanes import VEHICLE_LENGTH, WIDTH

NO_PLAN = -1  # the way does not ask for a lane of the road


@borrowing
def _between(
    follower: int,
    leader: int,
    drivers: Floats,
    i: int,
    roads: Net,
    s: Floats,
    on: NDArray[np.bool_],
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    lane: Integers,
    target: Integers,
    target_speed: Floats,
) -> float:
    """IDM acceleration [m/s2] of `follower` behind `leader` (-1: nobody) if it drove like driver `i`; 0 of nobody."""
    if follower < 0:
        return 0.0
    own = lane[follower]
    gap, v_lead = math.inf, 0.0
    if leader >= 0:
        gap, v_lead = way_beyond(follower, leader, own, target[follower], roads, s, on, x, y), speed[leader]
        if math.isnan(gap):  # on the same road: measured on the lane, as in highway-env
            gap = along(roads.geometry, s, x, y, leader, own) - along(roads.geometry, s, x, y, follower, own)
            v_lead *= math.cos(heading[leader] - heading[follower])
    return behind(drivers, i, speed[follower], target_speed[follower], roads.geometry[own, LIMIT], gap, v_lead)


@borrowing
def _gives_up(
    i: int,
    drivers: Floats,
    geometry: Floats,
    s: Floats,
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    lane: Integers,
    target: Integers,
) -> bool:
    """Is somebody ahead, closer than vehicle `i` likes and not there yet, changing to the same lane?"""
    for j in range(len(s)):
        if j == i or lane[j] == target[i] or target[j] != target[i]:
            continue
        v_lead = speed[j] * math.cos(heading[j] - heading[i])
        gap = desired_gap(
            speed[i], v_lead, drivers[i, A_MAX], drivers[i, B], drivers[i, S0], drivers[i, TAU]
        )
        ahead = along(geometry, s, x, y, j, lane[i]) - along(geometry, s, x, y, i, lane[i])
        if 0.0 < ahead < gap:
            return True
    return False


@borrowing
def _mobil(
    i: int,
    new: int,
    drivers: Floats,
    roads: Net,
    s: Floats,
    on: NDArray[np.bool_],
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    lane: Integers,
    target: Integers,
    target_speed: Floats,
    planned: Integers,
) -> bool:
    """``IDMVehicle.mobil``: may vehicle `i` change to lane `new`, and is it worth it or planned?"""
    preceding, following = neighbours(i, new, roads, s, on, x, y)
    imposed = _between(following, i, drivers, i, roads, s, on, x, y, speed, heading, lane, target, target_speed)
    if imposed < -SAFE_BRAKING:
        return False
    after = _between(i, preceding, drivers, i, roads, s, on, x, y, speed, heading, lane, target, target_speed)
    if planned[i] != NO_PLAN:
        # only toward the planned lane; who is there already stays
        here = target[i] - roads.first[target[i]]
        if np.sign(new - roads.first[new] - here) != np.sign(planned[i] - here):
            return False
        return after >= -SAFE_BRAKING
    old = neighbours(i, lane[i], roads, s, on, x, y)[0]
    before = _between(i, old, drivers, i, roads, s, on, x, y, speed, heading, lane, target, target_speed)
    return after - before >= MIN_GAIN


@borrowing
def drive(
    roads: Net,
    ways: Integers,
    leg: Integers,
    planned: Integers,
    lane: Integers,
    target: Integers,
    timer: Floats,
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    target_speed: Floats,
    drivers: Floats,
    acts: NDArray[np.bool_],
    changes: NDArray[np.bool_],
    s: Floats,
    on: NDArray[np.bool_],
    acceleration: Floats,
) -> None:
    """What ``IDMVehicle.act`` commands every vehicle that acts, into `acceleration` [m/s2], shape (n,).

    Changes `leg`, `planned`, `target` and `timer` in place. The caller adds the time to `timer` afterwards.

    Args:
        roads: of `net`.
        ways: roads of each vehicle's way, by their first lanes, padded with -1, shape (n, roads of a way).
        leg: which of them the target lane is on, shape (n,).
        planned: id of the lane of its first road that a vehicle was put on, which it does not leave of its own
            accord; NO_PLAN once it is beyond, shape (n,).
        lane: number of the lane that each vehicle is on, shape (n,).
        target: number of the lane that it steers for, shape (n,); also of vehicles that do not act.
        timer: time since the last decision on lane changes [s], shape (n,).
        x, y, speed, heading, target_speed: shape (n,) [m, m, m/s, rad, m/s].
        drivers: shape (n, 6), the columns of `idm`.
        acts: who is driven here (neither the ego nor wrecks), shape (n,).
        changes: who of them decides on lane changes, shape (n,).
        s, on: of `locate`.
    """
    geometry = roads.geometry
    for i in range(len(x)):
        if not acts[i]:
            continue
        if along(geometry, s, x, y, i, target[i]) > geometry[target[i], LENGTH] - VEHICLE_LENGTH / 2:
            planned[i] = NO_PLAN
            if leg[i] + 1 < ways.shape[1] and ways[i, leg[i] + 1] >= 0:
                leg[i] += 1
                target[i] = next_target(target[i], ways[i, leg[i]], roads, x[i], y[i])
        own = lane[i]
        if not changes[i]:
            pass
        elif own != target[i]:
            same_road = roads.first[own] == roads.first[target[i]]
            if same_road and _gives_up(i, drivers, geometry, s, x, y, speed, heading, lane, target):
                target[i] = own
        elif timer[i] > DELAY:
            timer[i] = 0.0
            for new in (own - 1, own + 1):
                if not roads.first[own] <= new < roads.first[own] + roads.abreast[own]:
                    continue
                there, lat = local_coordinates(geometry, new, x[i], y[i])
                within = 0.0 <= there < geometry[new, LENGTH] + VEHICLE_LENGTH
                if not within or abs(lat) > 2.0 * WIDTH or abs(speed[i]) < MIN_SPEED:
                    continue
                if _mobil(i, new, drivers, roads, s, on, x, y, speed, heading, lane, target, target_speed, planned):
                    target[i] = new
        front = neighbours(i, own, roads, s, on, x, y)[0]
        a = _between(i, front, drivers, i, roads, s, on, x, y, speed, heading, lane, target, target_speed)
        if own != target[i]:
            front = neighbours(i, target[i], roads, s, on, x, y)[0]
            a = min(a, _between(i, front, drivers, i, roads, s, on, x, y, speed, heading, lane, target, target_speed))
        acceleration[i] = min(max(a, -drivers[i, ACC_MAX]), drivers[i, ACC_MAX])


@compiled
def act(
    roads: Net,
    ways: Integers,
    floats: Floats,
    integers: Integers,
    flags: Flags,
    drivers: Floats,
    moved: bool,
    dt: float,
) -> None:
    """`drive` with the matrices of `cars.Cars`, and the time after it; 0 is commanded to those that do not act.

    moved: whether vehicles have moved since the lanes that they are `ON` were found.
    """
    on, target, timer, forced = integers[ON], integers[TARGET], floats[TIMER], flags[FORCED]
    acts, changes = ~flags[CRASHED], flags[CHANGES].copy()
    acts[0] = False
    for i in range(len(on)):
        forced[i] = forced[i] and on[i] != target[i]
        changes[i] = changes[i] and not forced[i]
    shape = len(on), len(roads.geometry)
    s, located = np.full(shape, np.nan), np.zeros(shape, np.bool_)
    locate(roads, floats[X], floats[Y], floats[HEADING], on, moved, s, located)
    floats[ACCELERATION] = 0.0
    drive(
        roads, ways, integers[LEG], integers[PLANNED], on, target, timer, floats[X], floats[Y], floats[SPEED],
        floats[HEADING], floats[TARGET_SPEED], drivers, acts, changes, s, located, floats[ACCELERATION],
    )  # fmt: skip
    timer += dt
