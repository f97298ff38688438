"""Contacts between cars: highway-env's test of rectangles now and after one step (``RoadObject.handle_collisions``)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from experiments.backends.replica.compiled import compiled

HALF_LENGTH, HALF_WIDTH = 2.5, 1.0  # [m]
DIAGONAL = math.sqrt(29.0)  # [m]
# Normals of the sides of a rectangle, in its own frame and in highway-env's order:
NORMALS = ((-1.0, 0.0), (0.0, 1.0), (1.0, 0.0), (0.0, -1.0))


@compiled
def reach(normal_x: float, normal_y: float, heading: float) -> float:
    """Half the extent of a rectangle along a direction [m]."""
    c, s = math.cos(heading), math.sin(heading)
    return HALF_LENGTH * abs(normal_x * c + normal_y * s) + HALF_WIDTH * abs(normal_y * c - normal_x * s)


@compiled
def apart(low: float, high: float, other_low: float, other_high: float) -> float:
    """``utils.interval_distance``, negative if the intervals overlap."""
    return other_low - high if low < other_low else low - other_high


@compiled
def touch(a: Any, b: Any, dt: float) -> tuple[bool, bool, float, float]:
    """``utils.are_polygons_intersecting``: do cars touch now, will they in `dt` [s], and the way that frees the first [m].

    The way, x and y, means something only if they will touch.
    """
    now, soon, least, way_x, way_y = True, True, math.inf, 0.0, 0.0
    move_x = (a.speed * math.cos(a.heading) - b.speed * math.cos(b.heading)) * dt
    move_y = (a.speed * math.sin(a.heading) - b.speed * math.sin(b.heading)) * dt
    for heading in (a.heading, b.heading):
        c, s = math.cos(heading), math.sin(heading)
        for u, v in NORMALS:
            nx, ny = u * c - v * s, u * s + v * c
            centre, other = a.x * nx + a.y * ny, b.x * nx + b.y * ny
            half, other_half = reach(nx, ny, a.heading), reach(nx, ny, b.heading)
            low, high = centre - half, centre + half
            if apart(low, high, other - other_half, other + other_half) > 0.0:
                now = False
            move = nx * move_x + ny * move_y
            if move < 0.0:
                low += move
            else:
                high += move
            distance = apart(low, high, other - other_half, other + other_half)
            if distance > 0.0:
                soon = False
            if not now and not soon:
                return False, False, 0.0, 0.0
            if abs(distance) < least:
                least = abs(distance)
                side = 1.0 if centre > other else -1.0
                way_x, way_y = side * nx, side * ny
    return now, soon, least * way_x, least * way_y


@compiled
def collide(cars: Any, dt: float) -> None:
    """Find who touches whom: marks wrecks, and how far those that will touch are pushed apart in the next step."""
    n = len(cars)
    x, y = np.empty(n), np.empty(n)
    for i in range(n):
        x[i], y[i] = cars[i].x, cars[i].y
    for i in range(n):
        near = DIAGONAL + cars[i].speed * dt  # the speed of the first alone counts, as in highway-env
        for j in range(i + 1, n):
            dx, dy = x[j] - x[i], y[j] - y[i]
            if abs(dx) > near or abs(dy) > near or math.sqrt(dx * dx + dy * dy) > near:
                continue
            a, b = cars[i], cars[j]
            now, soon, way_x, way_y = touch(a, b, dt)
            if soon:
                a.is_pushed_apart = b.is_pushed_apart = True
                a.apart_x, a.apart_y = way_x / 2.0, way_y / 2.0
                b.apart_x, b.apart_y = -way_x / 2.0, -way_y / 2.0
            if now:
                a.crashed = b.crashed = True
