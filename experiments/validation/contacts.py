"""Who touches whom, and who gets into whose way: highway-env's tests of rectangles, compiled (for `accelerate`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from experiments.validation.kernels import VEHICLE_LENGTH, VEHICLE_WIDTH
from sumo_env.compiled import compiled
from sumo_env.models.lane_table import LENGTH, heading_at, local_coordinates, position

REACH = math.sqrt(29.0)  # [m] RoadObject.diagonal


@compiled
def collisions(x: Any, y: Any, heading: Any, speed: Any, dt: float) -> tuple[Any, Any, Any]:
    """``RoadObject._is_colliding`` of all pairs: those that touch now or after `dt` [s], in order.

    Returns:
        Pairs (i, j), i < j, shape (pairs, 2); whether they touch now, shape (pairs,); and the way [m] that the second
        is pushed apart from the first, nan unless they touch after `dt`, shape (pairs, 2).
    """
    pairs = near_pairs(x, y, speed, dt)
    touching, ways = np.zeros(len(pairs), np.bool_), np.full((len(pairs), 2), math.nan)
    kept = np.zeros(len(pairs), np.bool_)
    for k in range(len(pairs)):
        i, j = pairs[k]
        a, b = polygon(x[i], y[i], heading[i]), polygon(x[j], y[j], heading[j])
        dx = speed[i] * math.cos(heading[i]) * dt - speed[j] * math.cos(heading[j]) * dt
        dy = speed[i] * math.sin(heading[i]) * dt - speed[j] * math.sin(heading[j]) * dt
        now, soon, least, way_x, way_y = intersection(a, b, dx, dy)
        touching[k], kept[k] = now, now or soon
        if soon:
            ways[k, 0], ways[k, 1] = least * way_x, least * way_y
    return pairs[kept], touching[kept], ways[kept]


@compiled
def polygon(x: float, y: float, heading: float) -> Any:
    """``RoadObject.polygon``: the corners of a vehicle and the first again, shape (5, 2)."""
    c, s = math.cos(heading), math.sin(heading)
    points = np.empty((5, 2))
    for k in range(5):
        along = VEHICLE_LENGTH / 2 if k in (2, 3) else -VEHICLE_LENGTH / 2
        across = VEHICLE_WIDTH / 2 if k in (1, 2) else -VEHICLE_WIDTH / 2
        points[k, 0], points[k, 1] = c * along - s * across + x, s * along + c * across + y
    return points


@compiled
def intersection(a: Any, b: Any, dx: float, dy: float) -> tuple[bool, bool, float, float, float]:
    """``utils.are_polygons_intersecting``: now, after a move (dx, dy) [m], overlap [m] and its direction (x, y)."""
    now, soon, least, way_x, way_y = True, True, math.inf, 0.0, 0.0
    apart_x = (a[0, 0] + a[1, 0] + a[2, 0] + a[3, 0]) / 4 - (b[0, 0] + b[1, 0] + b[2, 0] + b[3, 0]) / 4
    apart_y = (a[0, 1] + a[1, 1] + a[2, 1] + a[3, 1]) / 4 - (b[0, 1] + b[1, 1] + b[2, 1] + b[3, 1]) / 4
    for side in range(8):
        sides, k = (a, side) if side < 4 else (b, side - 4)
        nx, ny = sides[k, 1] - sides[k + 1, 1], sides[k + 1, 0] - sides[k, 0]
        norm = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / norm, ny / norm
        first, second = a[:, 0] * nx + a[:, 1] * ny, b[:, 0] * nx + b[:, 1] * ny
        low, high, other_low, other_high = first.min(), first.max(), second.min(), second.max()
        if interval_distance(low, high, other_low, other_high) > 0:
            now = False
        move = nx * dx + ny * dy
        if move < 0:
            low += move
        else:
            high += move
        distance = interval_distance(low, high, other_low, other_high)
        if distance > 0:
            soon = False
        if not now and not soon:
            break
        if abs(distance) < least:
            least = abs(distance)
            if apart_x * nx + apart_y * ny > 0:
                way_x, way_y = nx, ny
            else:
                way_x, way_y = -nx, -ny
    return now, soon, least, way_x, way_y


@compiled
def interval_distance(low: float, high: float, other_low: float, other_high: float) -> float:
    """``utils.interval_distance``, negative if the intervals overlap."""
    return other_low - high if low < other_low else low - other_high


@compiled
def near_pairs(x: Any, y: Any, speed: Any, dt: float) -> Any:
    """Pairs (i, j), i < j, that pass ``RoadObject._is_colliding``'s first test, in order; shape (pairs, 2)."""
    found = []
    for i in range(len(x)):
        reach = REACH + speed[i] * dt
        for j in range(i + 1, len(x)):
            dx, dy = x[j] - x[i], y[j] - y[i]
            if math.sqrt(dx * dx + dy * dy) <= reach:
                found.append((i, j))
    result = np.empty((len(found), 2), np.int64)
    for k, pair in enumerate(found):
        result[k, 0], result[k, 1] = pair
    return result


@compiled
def predicted(geometry: Any, route: Any, s: float) -> tuple[float, float, float]:
    """``RoadNetwork.position_heading_along_route``: x, y [m] and heading [rad], `s` [m] along a route."""
    k = 0
    while k + 1 < len(route) and route[k + 1] >= 0 and s > geometry[route[k], LENGTH]:
        s -= geometry[route[k], LENGTH]
        k += 1
    x, y = position(geometry, route[k], s)
    return x, y, heading_at(geometry, route[k], s)


@compiled
def has_point_inside(
    x: float, y: float, heading: float, other_x: float, other_y: float, turned: float
) -> bool:
    """``utils.has_corner_inside`` of rectangles 7.5 x 1.8 m; it turns points the wrong way, and so does this."""
    length, width = 1.5 * VEHICLE_LENGTH / 2, 0.9 * VEHICLE_WIDTH / 2
    c, s = math.cos(heading), math.sin(heading)
    ct, st = math.cos(turned), math.sin(turned)
    for i in range(-1, 2):
        for j in range(-1, 2):
            dx = x + c * i * length - s * j * width - other_x
            dy = y + s * i * length + c * j * width - other_y
            if abs(ct * dx - st * dy) <= length and abs(st * dx + ct * dy) <= width:
                return True
    return False


@compiled
def conflicts(geometry: Any, routes: Any, lanes: Any, x: Any, y: Any, speed: Any) -> Any:
    """``RegulatedRoad.is_conflict_possible`` of all pairs, shape (n, n).

    Args:
        routes: the numbers of the lanes of each vehicle's route, shape (n, most), padded with -1.
        lanes: the lane of each vehicle, shape (n,).
    """
    n, times = len(x), 11  # 0.25, 0.5 .. 2.75 s
    ahead = np.empty((n, times, 3))
    for i in range(n):
        s = local_coordinates(geometry, lanes[i], x[i], y[i])[0]
        for k in range(times):
            ahead[i, k] = predicted(geometry, routes[i], s + speed[i] * 0.25 * (k + 1))
    found = np.zeros((n, n), np.bool_)
    for i in range(n):
        for j in range(i + 1, n):
            for k in range(times):
                xi, yi, hi = ahead[i, k]
                xj, yj, hj = ahead[j, k]
                dx, dy = xj - xi, yj - yi
                if dx * dx + dy * dy > VEHICLE_LENGTH * VEHICLE_LENGTH:
                    continue
                if has_point_inside(xi, yi, hi, xj, yj, hj) or has_point_inside(xj, yj, hj, xi, yi, hi):
                    found[i, j] = True
                    break
    return found
