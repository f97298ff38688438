"""Right of way at the intersection: highway-env's ``RegulatedRoad``.

Twice a second all drivers are released, and then every pair of vehicles is looked at: each is predicted along
its route at its present speed, and if the two would meet within three seconds one of them has to give way,
that is, its desired speed becomes 0 until the next time. It is the one on the lane of lower priority; on
lanes of equal priority the one that has the other further in front of itself. The ego is never made to give
way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sumo_env.cars import HEADING, SPEED, TARGET_SPEED, YIELDING, Flags, X, Y
from sumo_env.compiled import borrowing, compiled
from sumo_env.models.lane_table import (
    LENGTH,
    LIMIT,
    PRIORITY,
    Floats,
    Integers,
    advance,
    heading_at,
    local_coordinates,
    position,
    target_stage,
)

PERIOD = 7 / 15  # [s] every int(15 / REGULATION_FREQUENCY) sub-steps of 1/15 s
SAMPLES = 11  # predictions of each vehicle, at 0.25, 0.5 ... 2.75 s
SAMPLE_STEP = 0.25  # [s]
MEETING_DISTANCE = 5.0  # centres further apart than this do not meet [m]
# Rectangles that stand for predicted vehicles: 7.5 m by 1.8 m.
HALF_LENGTH = 1.5 * 5.0 / 2  # [m]
HALF_WIDTH = 0.9 * 2.0 / 2  # [m]


@borrowing
def _reaches_into(dx: float, dy: float, h1: float, h2: float) -> bool:
    """Is one of nine points of rectangle 1 (corners, midpoints, centre) in rectangle 2, (dx, dy) away?

    highway-env's test, with its two peculiarities: rectangles that cross like a plus sign can pass unseen
    (``utils.has_corner_inside``), and points are turned into the frame of rectangle 2 the wrong way round
    (``utils.point_in_rotated_rectangle``), which matters in bends.
    """
    cos, sin = math.cos(h1 + h2), math.sin(h1 + h2)
    x = dy * math.sin(h2) - dx * math.cos(h2)  # centre of rectangle 1 in the frame of rectangle 2
    y = -dx * math.sin(h2) - dy * math.cos(h2)
    for along in (-HALF_LENGTH, 0.0, HALF_LENGTH):
        for across in (-HALF_WIDTH, 0.0, HALF_WIDTH):
            inside_x = abs(x + along * cos - across * sin) <= HALF_LENGTH
            if inside_x and abs(y + along * sin + across * cos) <= HALF_WIDTH:
                return True
    return False


@compiled
def _predict(
    geometry: Floats, routes: Integers, stage: Integers, x: Floats, y: Floats, speed: Floats
) -> Floats:
    """Predicted (x, y, heading) [m, m, rad] of each vehicle at constant speed, shape (n, SAMPLES, 3).

    As in highway-env the distance along the route begins on the lane that the vehicle *steers for*, while the
    distance driven on it is that on the lane it *is* on: for the last 2.5 m of a lane, predictions run too
    far ahead.
    """
    result = np.empty((len(x), SAMPLES, 3))
    for i in range(len(x)):
        s = local_coordinates(geometry, routes[i, stage[i]], x[i], y[i])[0]
        first = target_stage(geometry, routes, stage, i, s)
        for k in range(SAMPLES):
            at, ahead = first, s + speed[i] * SAMPLE_STEP * (k + 1)
            while (
                at + 1 < routes.shape[1]
                and routes[i, at + 1] >= 0
                and ahead > geometry[routes[i, at], LENGTH]
            ):
                ahead -= geometry[routes[i, at], LENGTH]
                at += 1
            result[i, k, 0], result[i, k, 1] = position(geometry, routes[i, at], ahead)
            result[i, k, 2] = heading_at(geometry, routes[i, at], ahead)
    return result


@borrowing
def _meet(first: Floats, second: Floats) -> bool:
    """Do two predicted vehicles meet? Shapes (SAMPLES, 3)."""
    for k in range(SAMPLES):
        dx, dy = second[k, 0] - first[k, 0], second[k, 1] - first[k, 1]
        if dx * dx + dy * dy > MEETING_DISTANCE * MEETING_DISTANCE:
            continue
        if _reaches_into(dx, dy, first[k, 2], second[k, 2]) or _reaches_into(
            -dx, -dy, second[k, 2], first[k, 2]
        ):
            return True
    return False


@compiled
def regulate(
    geometry: Floats,
    routes: Integers,
    stage: Integers,
    x: Floats,
    y: Floats,
    speed: Floats,
    heading: Floats,
    exempt: NDArray[np.bool_],
    target_speed: Floats,
    yielding: NDArray[np.bool_],
) -> None:
    """Release those who gave way, find those who have to now: changes `target_speed` and `yielding` in place.

    To be called every PERIOD. Who is released gets the speed limit of its lane as desired speed, whatever it
    wanted before; who has to give way, 0.

    Args:
        geometry: of a `LaneTable`.
        routes, stage: shapes (n, lanes of a route) and (n,); call `advance` first.
        x, y, speed, heading: shape (n,) [m, m, m/s, rad]; all vehicles, wrecks too.
        exempt: who does not give way (the ego; risky drivers), shape (n,). Nobody gives way in their stead.
        target_speed: desired speeds, shape (n,) [m/s].
        yielding: who is giving way, shape (n,).
    """
    predicted = _predict(geometry, routes, stage, x, y, speed)
    n = len(x)
    for i in range(n):
        if yielding[i]:
            target_speed[i] = geometry[routes[i, stage[i]], LIMIT]
            yielding[i] = False
    for i in range(n):
        for j in range(i + 1, n):
            if not _meet(predicted[i], predicted[j]):
                continue
            priority_i = geometry[routes[i, stage[i]], PRIORITY]
            priority_j = geometry[routes[j, stage[j]], PRIORITY]
            dx, dy = x[j] - x[i], y[j] - y[i]
            front_i = math.cos(heading[i]) * dx + math.sin(heading[i]) * dy  # how far j is in front of i
            front_j = -math.cos(heading[j]) * dx - math.sin(heading[j]) * dy
            if priority_i != priority_j:
                loser = j if priority_i > priority_j else i
            else:
                loser = i if front_i > front_j else j
            if not exempt[loser]:
                target_speed[loser] = 0.0
                yielding[loser] = True


@borrowing
def give_way(
    geometry: Floats,
    routes: Integers,
    stage: Integers,
    exempt: Flags,
    clock: Floats,
    floats: Floats,
    flags: Flags,
    dt: float,
) -> None:
    """`regulate` when it is time to, with the matrices of `cars.Cars`; clock: time since then [s], shape (1,)."""
    if clock[0] >= PERIOD - 1e-9:
        clock[0] -= PERIOD
        advance(geometry, routes, stage, floats[X], floats[Y])
        regulate(
            geometry, routes, stage, floats[X], floats[Y], floats[SPEED], floats[HEADING], exempt,
            floats[TARGET_SPEED], flags[YIELDING],
        )  # fmt: skip
    clock[0] += dt
