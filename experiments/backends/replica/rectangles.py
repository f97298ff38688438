"""Distances of cars as rectangles, and the time until the ego touches somebody: what risk events and measures ask.

The formulas are those of `sumo_env.collision` and `sumo_env.safety`.
"""

from __future__ import annotations

import math
from typing import Any

from experiments.backends.replica.compiled import compiled
from sumo_env.safety import HORIZON

LENGTH, WIDTH = 5.0, 2.0  # [m]
DIAGONAL = math.sqrt(LENGTH**2 + WIDTH**2)


@compiled
def separation(x1: float, y1: float, h1: float, x2: float, y2: float, h2: float) -> float:
    """Largest gap [m] between two rectangles over the directions of their sides, positive if they are apart."""
    dx, dy = x2 - x1, y2 - y1
    cos, sin = abs(math.cos(h2 - h1)), abs(math.sin(h2 - h1))
    along = (LENGTH + LENGTH * cos + WIDTH * sin) / 2.0
    across = (WIDTH + LENGTH * sin + WIDTH * cos) / 2.0
    gap = -math.inf
    for h in (h1, h2):
        c, s = math.cos(h), math.sin(h)
        gap = max(gap, abs(dx * c + dy * s) - along, abs(dy * c - dx * s) - across)
    return gap


@compiled
def corner_distance(x1: float, y1: float, h1: float, x2: float, y2: float, h2: float) -> float:
    """Distance [m] from rectangle 1 to the nearest corner of rectangle 2."""
    c, s = math.cos(h1), math.sin(h1)
    cos, sin = math.cos(h2 - h1), math.sin(h2 - h1)
    x, y = (x2 - x1) * c + (y2 - y1) * s, (y2 - y1) * c - (x2 - x1) * s
    nearest = math.inf
    for along in (-LENGTH / 2.0, LENGTH / 2.0):
        for across in (-WIDTH / 2.0, WIDTH / 2.0):
            dx = max(abs(x + along * cos - across * sin) - LENGTH / 2.0, 0.0)
            dy = max(abs(y + along * sin + across * cos) - WIDTH / 2.0, 0.0)
            nearest = min(nearest, dx * dx + dy * dy)
    return math.sqrt(nearest)


@compiled
def distance(x1: float, y1: float, h1: float, x2: float, y2: float, h2: float) -> float:
    """Distance [m] of two rectangles; in contact, minus the depth of penetration."""
    gap = separation(x1, y1, h1, x2, y2, h2)
    if gap <= 0.0:
        return gap
    return min(corner_distance(x1, y1, h1, x2, y2, h2), corner_distance(x2, y2, h2, x1, y1, h1))


@compiled
def touch_time(dx: float, dy: float, wx: float, wy: float, h1: float, h2: float, horizon: float) -> float:
    """Time [s] until two cars touch, inf if not within `horizon`; 0 if they do already.

    (dx, dy) is the way from the first centre to the second [m], (wx, wy) its rate of change [m/s].
    """
    cos, sin = abs(math.cos(h2 - h1)), abs(math.sin(h2 - h1))
    along = (LENGTH + LENGTH * cos + WIDTH * sin) / 2.0
    across = (WIDTH + LENGTH * sin + WIDTH * cos) / 2.0
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


@compiled
def ego_ttc(cars: Any) -> float:
    """``safety.min_ttc`` of the ego, row 0 [s]."""
    ego, least = cars[0], math.inf
    vx, vy = ego.speed * math.cos(ego.heading), ego.speed * math.sin(ego.heading)
    for j in range(1, len(cars)):
        car = cars[j]
        dx, dy = car.x - ego.x, car.y - ego.y
        horizon = min(least, HORIZON)
        # Circles that hold the cars cannot meet whatever their headings; the millimetre is for rounding.
        far = DIAGONAL + (abs(ego.speed) + abs(car.speed)) * horizon + 1e-3
        if dx * dx + dy * dy > far * far:
            continue
        wx, wy = car.speed * math.cos(car.heading) - vx, car.speed * math.sin(car.heading) - vy
        far = DIAGONAL + math.sqrt(wx * wx + wy * wy) * horizon
        if dx * dx + dy * dy <= far * far:
            least = min(least, touch_time(dx, dy, wx, wy, ego.heading, car.heading, horizon))
    return least
