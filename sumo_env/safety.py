"""Measures of danger short of a crash, computed alike for both simulators.

Time to collision (TTC) here is that of the vehicles' full rectangles in the plane, not of a gap along a lane:
the time until the two first touch if both keep their velocity and heading. It is exact, whatever the angle.
"""

from __future__ import annotations

import math

import numpy as np

from sumo_env.compiled import borrowing, compiled
from sumo_env.scene import VEHICLE_LENGTH, VEHICLE_WIDTH, Floats

NEAR_MISS_TTC = 1.5  # a smaller time to collision without a crash is a near-miss [s]
HORIZON = 10.0  # how far ahead it is worth looking [s]
DENSITY_RADIUS = 200.0  # [m]
CORRIDOR_HALF_WIDTH, CORRIDOR_LENGTH = 2.0, 60.0  # where a leader is looked for, from centre to centre [m]
MIN_SPEED = 0.1  # below it a headway means nothing [m/s]


@borrowing
def _touch_time(dx: float, dy: float, wx: float, wy: float, h1: float, h2: float, horizon: float) -> float:
    """Time [s] until two vehicles touch, inf if not within `horizon`; 0 if they do already.

    (dx, dy) is the way from the first centre to the second [m], (wx, wy) its rate of change [m/s]. Along each
    of the four directions of the sides the shadows of the rectangles overlap during one interval of time; the
    rectangles are in contact while all four do.
    """
    cos, sin = abs(math.cos(h2 - h1)), abs(math.sin(h2 - h1))
    along = (VEHICLE_LENGTH + VEHICLE_LENGTH * cos + VEHICLE_WIDTH * sin) / 2.0
    across = (VEHICLE_WIDTH + VEHICLE_LENGTH * sin + VEHICLE_WIDTH * cos) / 2.0
    begin, end = 0.0, horizon
    for k in range(4):
        h = h1 if k < 2 else h2
        c, s = math.cos(h), math.sin(h)
        if k % 2 == 0:
            apart, rate, reach = dx * c + dy * s, wx * c + wy * s, along
        else:
            apart, rate, reach = dy * c - dx * s, wy * c - wx * s, across
        if abs(rate) < 1e-12:
            if abs(apart) > reach:
                return math.inf
            continue
        first, last = (-reach - apart) / rate, (reach - apart) / rate
        if rate < 0.0:
            first, last = last, first
        begin, end = max(begin, first), min(end, last)
        if begin > end:
            return math.inf
    return begin


@borrowing
def _pair_ttc(
    i: int, j: int, x: Floats, y: Floats, vx: Floats, vy: Floats, heading: Floats, horizon: float
) -> float:
    """`_touch_time` of two vehicles, after a look at whether their circumscribed circles can meet in time."""
    dx, dy = x[j] - x[i], y[j] - y[i]
    wx, wy = vx[j] - vx[i], vy[j] - vy[i]
    reach = math.sqrt(VEHICLE_LENGTH**2 + VEHICLE_WIDTH**2) + math.sqrt(wx * wx + wy * wy) * horizon
    if dx * dx + dy * dy > reach * reach:
        return math.inf
    return _touch_time(dx, dy, wx, wy, heading[i], heading[j], horizon)


@compiled
def time_to_collision(
    x: Floats, y: Floats, vx: Floats, vy: Floats, heading: Floats, ego: int, horizon: float
) -> Floats:
    """Time [s] until `ego` touches each vehicle, shape (n,): 0 in contact, inf if not within `horizon`.

    x, y [m], vx, vy [m/s], heading [rad]: shape (n,).
    """
    result = np.empty(len(x))
    for j in range(len(x)):
        result[j] = math.inf if j == ego else _pair_ttc(ego, j, x, y, vx, vy, heading, horizon)
    return result


@borrowing
def min_ttc(x: Floats, y: Floats, vx: Floats, vy: Floats, heading: Floats, ego: int, horizon: float) -> float:
    """The least `time_to_collision` of vehicle `ego` [s], inf if there is none within `horizon`."""
    least = math.inf
    for j in range(len(x)):
        if j != ego:
            least = min(least, _pair_ttc(ego, j, x, y, vx, vy, heading, min(least, horizon)))
    return least


@borrowing
def ego_ttc(x: Floats, y: Floats, speed: Floats, heading: Floats, horizon: float) -> float:
    """`min_ttc` of row 0 by speeds [m/s] and headings [rad], shape (n,): no cosine for those far away."""
    least = math.inf
    vx, vy = speed[0] * math.cos(heading[0]), speed[0] * math.sin(heading[0])
    diagonal = math.sqrt(VEHICLE_LENGTH**2 + VEHICLE_WIDTH**2)
    for j in range(1, len(x)):
        dx, dy = x[j] - x[0], y[j] - y[0]
        limit = min(least, horizon)
        # Circles that hold the vehicles cannot meet however they head; the millimetre is for rounding.
        reach = diagonal + (abs(speed[0]) + abs(speed[j])) * limit + 1e-3
        if dx * dx + dy * dy > reach * reach:
            continue
        wx, wy = speed[j] * math.cos(heading[j]) - vx, speed[j] * math.sin(heading[j]) - vy
        reach = diagonal + math.sqrt(wx * wx + wy * wy) * limit
        if dx * dx + dy * dy <= reach * reach:
            least = min(least, _touch_time(dx, dy, wx, wy, heading[0], heading[j], limit))
    return least


@compiled
def pair_ttc(x: Floats, y: Floats, vx: Floats, vy: Floats, heading: Floats, horizon: float) -> Floats:
    """Time to collision [s] of all pairs i < j, shape (n, n); inf on and below the diagonal."""
    n = len(x)
    result = np.full((n, n), math.inf)
    for i in range(n):
        for j in range(i + 1, n):
            result[i, j] = _pair_ttc(i, j, x, y, vx, vy, heading, horizon)
    return result


@compiled
def headways(x: Floats, y: Floats, speed: Floats, heading: Floats) -> Floats:
    """Time gap [s] of each vehicle to its leader, bumper to bumper, shape (n,).

    The leader is the nearest vehicle whose centre lies in a straight corridor of 2 m to either side and 60 m
    ahead (so that in bends it may be a vehicle of another lane). inf without one, or at a standstill.
    """
    n = len(x)
    result = np.full(n, math.inf)
    for i in range(n):
        if speed[i] < MIN_SPEED:
            continue
        c, s = math.cos(heading[i]), math.sin(heading[i])
        nearest = math.inf
        for j in range(n):
            dx, dy = x[j] - x[i], y[j] - y[i]
            ahead = dx * c + dy * s
            if j != i and 0.0 < ahead <= CORRIDOR_LENGTH and abs(dy * c - dx * s) <= CORRIDOR_HALF_WIDTH:
                nearest = min(nearest, ahead)
        result[i] = (nearest - VEHICLE_LENGTH) / speed[i]
    return result


@borrowing
def density(x: Floats, y: Floats, ego: int, radius: float) -> int:
    """Number of other vehicles whose centre is within `radius` [m] of the centre of vehicle `ego`."""
    count = 0
    for j in range(len(x)):
        dx, dy = x[j] - x[ego], y[j] - y[ego]
        if j != ego and dx * dx + dy * dy <= radius * radius:
            count += 1
    return count
