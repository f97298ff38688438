"""Distances of cars as rectangles, and the time until the ego touches somebody: what risk events and measures ask.

`separation` and the two after it are `sumo_env.contacts.rectangles`' for numba, which compiles no generators.
"""

from __future__ import annotations

import math
from typing import Any

from sumo_env.contacts import measures
from sumo_env.contacts.measures import HORIZON, TTC_RADIUS
from sumo_env.replica.compiled import borrowing

LENGTH, WIDTH = 5.0, 2.0  # [m]

_ego_ttc = borrowing(measures.ego_ttc)


@borrowing
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


@borrowing
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


@borrowing
def distance(x1: float, y1: float, h1: float, x2: float, y2: float, h2: float) -> float:
    """Distance [m] of two rectangles; in contact, minus the depth of penetration."""
    gap = separation(x1, y1, h1, x2, y2, h2)
    if gap <= 0.0:
        return gap
    return min(corner_distance(x1, y1, h1, x2, y2, h2), corner_distance(x2, y2, h2, x1, y1, h1))


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
