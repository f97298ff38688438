"""Measures of danger short of a crash, computed alike for every simulator.

Time to collision (TTC) here is that of the vehicles' full rectangles in the plane, not of a gap along a lane: the time
until the two first touch if both keep their velocity and heading. It is exact, whatever the angle. The replica compiles
`ego_ttc`: plain floats only.
"""

from collections.abc import Iterable
from math import cos, inf, sin

import numpy as np

from sumo_env.contacts.rectangles import CAR, DIAGONAL, Half, State, extents, reach_of
from sumo_env.scene import VEHICLE_LENGTH, Floats

NEAR_MISS_TTC = 1.5  # [s] a smaller time to collision without a crash is a near-miss
HORIZON = 10.0  # [s] how far ahead the time to collision is looked for
DENSITY_RADIUS = 200.0  # [m]
TTC_RADIUS = 100.0  # [m] vehicles that are further from the ego are not looked at
CORRIDOR_HALF_WIDTH, CORRIDOR_LENGTH = 2.0, 60.0  # [m] where a leader is looked for, from centre to centre
MIN_SPEED = 0.1  # [m/s] below it a headway means nothing
PARALLEL = 1e-12  # [m/s] relative speed along an axis that counts as none
CLEARANCE = 1e-3  # [m2] beyond the squared distance of centres at which two vehicles may touch


def ego_ttc(
    ego: State, others: Iterable[State], horizon: float = HORIZON, half: Half = CAR, own: Half = CAR
) -> float:
    """Least time to collision of the ego with any of the others [s]; inf if there is none within `horizon` [s].

    0 in contact. The ego has the half size `own` [m], the others have `half`.
    """
    x, y, speed, heading = ego
    c1, s1 = cos(heading), sin(heading)
    vx, vy = speed * c1, speed * s1
    fastest, limit, found = abs(speed), horizon, False
    diagonal = DIAGONAL if half == CAR and own == CAR else reach_of(half, own)
    apart_from = diagonal * diagonal + CLEARANCE
    for ox, oy, other_speed, other_heading in others:
        dx, dy = ox - x, oy - y
        # No two vehicles close in faster than by the sum of their speeds.
        reach = diagonal + (fastest + abs(other_speed)) * limit
        squared = dx * dx + dy * dy
        if squared > reach * reach:
            continue
        c2, s2 = cos(other_heading), sin(other_heading)
        wx, wy = other_speed * c2 - vx, other_speed * s2 - vy
        closing = dx * wx + dy * wy
        if squared > apart_from and (
            closing >= 0.0 or (squared - apart_from) * (wx * wx + wy * wy) > closing * closing
        ):
            continue  # they separate, or pass further away than the two could touch
        parallel, across = abs(c1 * c2 + s1 * s2), abs(c1 * s2 - s1 * c2)
        length, width = extents(own, half, parallel, across)
        # Along each of the four directions of the sides the shadows of the rectangles overlap during one interval of
        # time; the rectangles are in contact while all four do. Across the ego first: it rules out other lanes.
        beside, drift = dy * c1 - dx * s1, wy * c1 - wx * s1
        if abs(beside) > width + abs(drift) * limit:
            continue
        other_length, other_width = extents(half, own, parallel, across)
        begin, end = 0.0, limit
        for apart, rate, extent in (
            (beside, drift, width),
            (dx * c1 + dy * s1, wx * c1 + wy * s1, length),
            (dy * c2 - dx * s2, wy * c2 - wx * s2, other_width),
            (dx * c2 + dy * s2, wx * c2 + wy * s2, other_length),
        ):
            if -PARALLEL < rate < PARALLEL:
                if apart > extent or apart < -extent:
                    break
                continue
            if rate < 0.0:
                apart, rate = -apart, -rate
            first, last = (-extent - apart) / rate, (extent - apart) / rate
            if first > begin:
                begin = first
            if last < end:
                end = last
            if begin > end:
                break
        else:
            limit, found = begin, True
    return limit if found else inf


def headways(x: Floats, y: Floats, speed: Floats, heading: Floats) -> Floats:
    """Time gap [s] of each vehicle to its leader, bumper to bumper; all arrays have shape (n,).

    The leader is the nearest vehicle whose centre lies in a straight corridor of 2 m to either side and 60 m ahead (so
    that in bends it may be a vehicle of another lane). inf without one, or at a standstill.
    """
    dx, dy = x - x[:, None], y - y[:, None]  # [i, j]: from i to j
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    ahead = dx * c + dy * s
    leads = (ahead > 0.0) & (ahead <= CORRIDOR_LENGTH) & (np.abs(dy * c - dx * s) <= CORRIDOR_HALF_WIDTH)
    np.fill_diagonal(leads, False)
    nearest = np.where(leads, ahead, inf).min(axis=1, initial=inf)
    moving = speed >= MIN_SPEED
    return np.where(moving, (nearest - VEHICLE_LENGTH) / np.where(moving, speed, 1.0), inf)


def density(x: Floats, y: Floats) -> int:
    """Number of other vehicles whose centre is within `DENSITY_RADIUS` of the first one's; x, y [m]: shape (n,)."""
    dx, dy = x - x[0], y - y[0]
    return int(np.count_nonzero(dx * dx + dy * dy <= DENSITY_RADIUS * DENSITY_RADIUS)) - 1
