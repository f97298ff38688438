"""Compiled contact tests, for the traffic model "matched"; everybody else uses `sumo_env.contacts`."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sumo_env.angles import wrapped
from sumo_env.compiled import borrowing, compiled
from sumo_env.contacts.crash import (  # noqa: F401 (kept here for the modules that go together with this one)
    SUMO_TOLERANCE,
    CrashRecord,
    Detector,
    classify,
    crash_record,
)
from sumo_env.contacts.rectangles import DIAGONAL, FINEST, LENGTH, ROUNDING, WIDTH
from sumo_env.scene import Floats, Scene

Integers = NDArray[np.int64]

NEAR = 1.0  # [m] further apart than this, SUMO's report of a contact is none: it reports cars up to 180 m apart


@borrowing
def separation(
    x1: float, y1: float, h1: float, x2: float, y2: float, h2: float, length: float, width: float
) -> float:
    """Largest gap [m] between two rectangles over the directions of their sides, positive if they are apart.

    Apart, it is a lower bound of their distance; in contact, minus the depth of penetration, that is, the
    least distance by which one has to be moved to free it. Centres (x, y) [m], headings h [rad], both of the
    same size [m].
    """
    dx, dy = x2 - x1, y2 - y1
    cos, sin = abs(math.cos(h2 - h1)), abs(math.sin(h2 - h1))
    # Half the extent of both together, along the length and across: the same for either, since the sizes are.
    along = (length + length * cos + width * sin) / 2.0
    across = (width + length * sin + width * cos) / 2.0
    gap = -math.inf
    for h in (h1, h2):
        c, s = math.cos(h), math.sin(h)
        gap = max(gap, abs(dx * c + dy * s) - along, abs(dy * c - dx * s) - across)
    return gap


@borrowing
def contact(
    x1: float, y1: float, h1: float, x2: float, y2: float, h2: float, length: float, width: float
) -> bool:
    """Are two rectangles in contact? Arguments as in `separation`."""
    return separation(x1, y1, h1, x2, y2, h2, length, width) <= 0.0


@borrowing
def _corner_distance(
    x1: float, y1: float, h1: float, x2: float, y2: float, h2: float, length: float, width: float
) -> float:
    """Distance [m] from rectangle 1 to the nearest corner of rectangle 2."""
    c, s = math.cos(h1), math.sin(h1)
    cos, sin = math.cos(h2 - h1), math.sin(h2 - h1)
    x, y = (x2 - x1) * c + (y2 - y1) * s, (y2 - y1) * c - (x2 - x1) * s
    nearest = math.inf
    for along in (-length / 2.0, length / 2.0):
        for across in (-width / 2.0, width / 2.0):
            dx = max(abs(x + along * cos - across * sin) - length / 2.0, 0.0)
            dy = max(abs(y + along * sin + across * cos) - width / 2.0, 0.0)
            nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)


@borrowing
def distance(
    x1: float, y1: float, h1: float, x2: float, y2: float, h2: float, length: float, width: float
) -> float:
    """Distance [m] of two rectangles; in contact, minus the depth of penetration. See `separation`."""
    gap = separation(x1, y1, h1, x2, y2, h2, length, width)
    if gap <= 0.0:
        return gap
    return min(
        _corner_distance(x1, y1, h1, x2, y2, h2, length, width),
        _corner_distance(x2, y2, h2, x1, y1, h1, length, width),
    )


@borrowing
def meeting(i: int, j: int, before: Floats, x: Floats, y: Floats, heading: Floats) -> float:
    """When two vehicles first touch on their way through a sub-step, 0 (its start) to 1; inf if they do not.

    Both move evenly from their pose before (shape (3, n): x, y [m], heading [rad]) to the one after (shape (n,)
    each) and turn the short way. Where they are apart by `gap`, they cannot meet before the fastest of their points
    have come that far: the next look is there (conservative advancement), or `FINEST` later, whichever is more.
    """
    rx, ry = before[0, j] - before[0, i], before[1, j] - before[1, i]
    ux, uy = x[j] - x[i] - rx, y[j] - y[i] - ry
    way = ux * ux + uy * uy
    nearest = 0.0 if way == 0.0 else min(max(-(rx * ux + ry * uy) / way, 0.0), 1.0)
    if (rx + nearest * ux) ** 2 + (ry + nearest * uy) ** 2 > DIAGONAL * DIAGONAL:
        return math.inf  # not even their circumscribed circles meet
    hi, hj = before[2, i], before[2, j]
    turn_i = wrapped(heading[i] - hi)
    turn_j = wrapped(heading[j] - hj)
    fastest = math.sqrt(way) + DIAGONAL / 2.0 * (abs(turn_i) + abs(turn_j))
    t = 0.0
    while True:
        gap = separation(0.0, 0.0, hi + t * turn_i, rx + t * ux, ry + t * uy, hj + t * turn_j, LENGTH, WIDTH)
        if gap <= ROUNDING:
            return t
        if t == 1.0 or gap > fastest * (1.0 - t):
            return math.inf
        t = min(t + max(gap / fastest, FINEST), 1.0)


@compiled
def meetings(
    before: Floats, x: Floats, y: Floats, heading: Floats, active: NDArray[np.bool_]
) -> tuple[Integers, Floats]:
    """Pairs i < j of vehicles that touch within a sub-step, shape (m, 2), and when, shape (m,): see `meeting`.

    At least one of a pair is active (say, not yet a wreck). active: shape (n,).
    """
    n = len(x)
    reach = 0.0
    for i in range(n):
        reach = max(reach, abs(x[i] - before[0, i]))
    reach = DIAGONAL + 2.0 * reach  # [m] along x, beyond which nobody meets
    found = 0
    pairs = np.empty((n, 2), dtype=np.int64)
    moments = np.empty(n)
    for i in range(n):
        for j in range(i + 1, n):
            if abs(before[0, j] - before[0, i]) > reach or not (active[i] or active[j]):
                continue
            moment = meeting(i, j, before, x, y, heading)
            if moment > 1.0:
                continue
            if found == len(pairs):
                pairs = np.concatenate((pairs, np.empty_like(pairs)))
                moments = np.concatenate((moments, np.empty_like(moments)))
            pairs[found, 0], pairs[found, 1], moments[found] = i, j, moment
            found += 1
    return pairs[:found].copy(), moments[:found].copy()


@compiled
def contacts(x: Floats, y: Floats, heading: Floats, active: NDArray[np.bool_]) -> Integers:
    """Pairs i < j of vehicles in contact where they are now, shape (m, 2), at least one of them active.

    x, y [m], heading [rad], active: shape (n,).
    """
    return meetings(np.stack((x, y, heading)), x, y, heading, active)[0]


def scene_between(before: Floats, scene: Scene, moment: float, dt: float) -> Scene:
    """The scene at a moment of the sub-step of `dt` [s] that it ends, 0 to 1: poses in between, speeds of its end.

    before: x, y [m] and heading [rad] at the start of the sub-step, shape (3, n).
    """
    turn = (scene.heading - before[2] + math.pi) % (2 * math.pi) - math.pi
    return replace(
        scene,
        x=before[0] + moment * (scene.x - before[0]),
        y=before[1] + moment * (scene.y - before[1]),
        heading=before[2] + moment * turn,
        time=round(scene.time - (1.0 - moment) * dt, 6),
    )
