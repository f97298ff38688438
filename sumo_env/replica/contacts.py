"""Contacts between cars: highway-env's test of rectangles now and after one step (``RoadObject.handle_collisions``).

And the time until the ego touches somebody, as it is measured for every simulator.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from sumo_env.contacts import measures
from sumo_env.contacts.measures import HORIZON, TTC_RADIUS
from sumo_env.contacts.rectangles import DIAGONAL, HALF_LENGTH, HALF_WIDTH
from sumo_env.replica.compiled import borrowing, compiled

_ego_ttc = borrowing(measures.ego_ttc)


@compiled
def corners(car: Any) -> Any:
    """``RoadObject.polygon``: the corners and the first again, shape (5, 2)."""
    c, s = car.cos, car.sin
    points = np.empty((5, 2))
    for k in range(5):
        along = HALF_LENGTH if k in (2, 3) else -HALF_LENGTH
        across = HALF_WIDTH if k in (1, 2) else -HALF_WIDTH
        points[k, 0], points[k, 1] = c * along - s * across + car.x, s * along + c * across + car.y
    return points


@borrowing
def interval_distance(low: float, high: float, other_low: float, other_high: float) -> float:
    """``utils.interval_distance``, negative if the intervals overlap."""
    return other_low - high if low < other_low else low - other_high


@compiled
def touch(first: Any, second: Any, dt: float) -> tuple[bool, bool, float, float]:
    """``utils.are_polygons_intersecting``: do cars touch now, will they after `dt` [s], and the way out of it.

    The way, x and y [m], moves the first car apart from the second; it means something only if they will touch.
    """
    a, b = corners(first), corners(second)
    move_x = first.speed * first.cos * dt - second.speed * second.cos * dt
    move_y = first.speed * first.sin * dt - second.speed * second.sin * dt
    apart_x, apart_y = a[:4, 0].mean() - b[:4, 0].mean(), a[:4, 1].mean() - b[:4, 1].mean()
    now, soon, least, way_x, way_y = True, True, math.inf, 0.0, 0.0
    for side in range(8):
        points, k = (a, side) if side < 4 else (b, side - 4)
        nx, ny = points[k, 1] - points[k + 1, 1], points[k + 1, 0] - points[k, 0]
        norm = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / norm, ny / norm
        shadow, other = a[:, 0] * nx + a[:, 1] * ny, b[:, 0] * nx + b[:, 1] * ny
        low, high, other_low, other_high = shadow.min(), shadow.max(), other.min(), other.max()
        if interval_distance(low, high, other_low, other_high) > 0.0:
            now = False
        move = nx * move_x + ny * move_y
        if move < 0.0:
            low += move
        else:
            high += move
        overlap = interval_distance(low, high, other_low, other_high)
        if overlap > 0.0:
            soon = False
        if not now and not soon:
            break
        if abs(overlap) < least:
            least = abs(overlap)
            sign = 1.0 if apart_x * nx + apart_y * ny > 0.0 else -1.0
            way_x, way_y = sign * nx, sign * ny
    return now, soon, least * way_x, least * way_y


@compiled
def collide(cars: Any, rules: Any) -> None:
    """Find who touches whom: marks wrecks, and how far those that will touch are pushed apart in the next step.

    Pairs are looked at in highway-env's order of vehicles, in which the first car, the ego, comes after
    ``rules.before_ego`` others; by ``rules.ego_contacts`` only those with the ego.
    """
    n, before_ego, dt = len(cars), rules.before_ego, rules.dt
    order, x, y = np.arange(n), np.empty(n), np.empty(n)
    order[:before_ego] = np.arange(1, before_ego + 1)
    order[before_ego] = 0
    for i in range(n):
        x[i], y[i] = cars[order[i]].x, cars[order[i]].y
    for i in range(n):
        a = cars[order[i]]
        near = DIAGONAL + a.speed * dt  # the speed of the first alone counts, as in highway-env
        for j in range(i + 1, n):
            if rules.ego_contacts and i != before_ego and j != before_ego:
                continue
            dx, dy = x[j] - x[i], y[j] - y[i]
            if abs(dx) > near or math.sqrt(dx * dx + dy * dy) > near:
                continue
            b = cars[order[j]]
            now, soon, way_x, way_y = touch(a, b, dt)
            if soon:
                a.is_pushed_apart = b.is_pushed_apart = True
                a.apart_x, a.apart_y = way_x / 2.0, way_y / 2.0
                b.apart_x, b.apart_y = -way_x / 2.0, -way_y / 2.0
            if now:
                a.crashed = b.crashed = True


@borrowing
def ego_ttc(cars: Any) -> float:
    """``measures.ego_ttc`` of the ego, the first car, with those within TTC_RADIUS [s]."""
    ego, least = cars[0], math.inf
    state = (ego.x, ego.y, ego.speed, ego.heading)
    for j in range(1, len(cars)):
        car = cars[j]
        if abs(car.x - ego.x) <= TTC_RADIUS and math.hypot(car.x - ego.x, car.y - ego.y) <= TTC_RADIUS:
            other = (car.x, car.y, car.speed, car.heading)
            least = min(least, _ego_ttc(state, (other,), min(least, HORIZON)))
    return least
