"""Contacts between vehicles, and what is written down about one.

Vehicles are oriented rectangles. Two convex shapes are apart if, and only if, a line separates them, and for
rectangles it is enough to try the directions of their four sides (separating axis theorem; figure 4 of the
paper). Rectangles that touch are in contact.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from sumo_env.compiled import compiled
from sumo_env.scene import VEHICLE_LENGTH, VEHICLE_WIDTH, Floats, Scene

Integers = NDArray[np.int64]
CrashType = Literal["rear-end", "side", "frontal", "junction"]
Detector = Literal["sumo", "geometry", "both", "highway-env"]

LENGTH: float = VEHICLE_LENGTH
WIDTH: float = VEHICLE_WIDTH
DIAGONAL = math.hypot(LENGTH, WIDTH)  # centres further apart than this are not in contact [m]
SAME_DIRECTION = math.pi / 4  # headings that differ by less are those of cars driving side by side [rad]
OPPOSITE_DIRECTION = 3 * math.pi / 4  # ... by more, of cars driving towards each other [rad]


@compiled
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


@compiled
def contact(
    x1: float, y1: float, h1: float, x2: float, y2: float, h2: float, length: float, width: float
) -> bool:
    """Are two rectangles in contact? Arguments as in `separation`."""
    return separation(x1, y1, h1, x2, y2, h2, length, width) <= 0.0


@compiled
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


@compiled
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


@compiled
def _pair_separation(i: int, j: int, x: Floats, y: Floats, heading: Floats) -> float:
    """`separation` of two vehicles; inf, at once, if their centres are too far apart for a contact."""
    dx, dy = x[j] - x[i], y[j] - y[i]
    if dx * dx + dy * dy > DIAGONAL * DIAGONAL:
        return math.inf
    return separation(x[i], y[i], heading[i], x[j], y[j], heading[j], LENGTH, WIDTH)


@compiled
def contacts(x: Floats, y: Floats, heading: Floats, active: NDArray[np.bool_]) -> Integers:
    """Pairs i < j of vehicles in contact, shape (m, 2), at least one of them active (say, not yet a wreck).

    x, y [m], heading [rad], active: shape (n,).
    """
    n = len(x)
    found = 0
    pairs = np.empty((n, 2), dtype=np.int64)
    for i in range(n):
        for j in range(i + 1, n):
            if not (active[i] or active[j]) or _pair_separation(i, j, x, y, heading) > 0.0:
                continue
            if found == len(pairs):
                longer = np.empty((2 * found, 2), dtype=np.int64)
                for k in range(found):
                    longer[k, 0], longer[k, 1] = pairs[k, 0], pairs[k, 1]
                pairs = longer
            pairs[found, 0], pairs[found, 1] = i, j
            found += 1
    return pairs[:found].copy()


@compiled
def any_contact(x: Floats, y: Floats, heading: Floats, wreck: NDArray[np.bool_]) -> bool:
    """Is there any pair in `contacts`, not both of which are wrecks? Shape (n,) each; allocates nothing."""
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            if not (wreck[i] and wreck[j]) and _pair_separation(i, j, x, y, heading) <= 0.0:
                return True
    return False


@compiled
def first_contact_with(index: int, x: Floats, y: Floats, heading: Floats) -> int:
    """The vehicle in contact with vehicle `index`, -1 if none; of several the one that reaches in deepest."""
    other, deepest = -1, 0.0
    for j in range(len(x)):
        if j == index:
            continue
        gap = _pair_separation(index, j, x, y, heading)
        if gap < deepest or (gap <= 0.0 and other < 0):
            other, deepest = j, gap
    return other


@dataclass(frozen=True, slots=True)
class CrashRecord:
    """A crash of the ego. "Relative" is in the ego's frame: x ahead of it, y to its right.

    Attributes:
        other: id of the other vehicle.
        time: since the start of the episode [s].
        x, y: centre of the ego [m].
        relative_x, relative_y: centre of the other vehicle [m].
        relative_heading: of the other vehicle [rad], in [-pi, pi).
        closing_speed: magnitude of the relative velocity [m/s] (0 for two cars side by side at one speed).
        type: see `classify`.
        detected_by: who noticed it.
    """

    other: str
    time: float
    x: float
    y: float
    relative_x: float
    relative_y: float
    relative_heading: float
    closing_speed: float
    type: CrashType
    detected_by: Detector

    def as_dict(self) -> dict[str, Any]:
        """The record as plain values, as in ``info["crash"]``."""
        return {field: getattr(self, field) for field in self.__slots__}


def classify(relative_x: float, relative_y: float, relative_heading: float) -> CrashType:
    """Name a crash by the other vehicle's pose in the ego's frame [m, m, rad].

    Headings within 45 degrees: ``rear-end`` if the other is rather ahead or behind than beside (each measured
    in vehicle sizes), ``side`` otherwise. Opposite within 45 degrees: ``frontal``. In between: ``junction``,
    of paths that cross.
    """
    angle = abs((relative_heading + math.pi) % (2 * math.pi) - math.pi)
    if angle > OPPOSITE_DIRECTION:
        return "frontal"
    if angle > SAME_DIRECTION:
        return "junction"
    return "rear-end" if abs(relative_x) / LENGTH >= abs(relative_y) / WIDTH else "side"


def crash_record(scene: Scene, other: int, detected_by: Detector) -> CrashRecord:
    """What is written down about the ego's crash with row `other` of the scene."""
    dx, dy = float(scene.x[other] - scene.x[0]), float(scene.y[other] - scene.y[0])
    cos, sin = math.cos(scene.heading[0]), math.sin(scene.heading[0])
    relative_x, relative_y = dx * cos + dy * sin, dy * cos - dx * sin
    turn = float(scene.heading[other] - scene.heading[0])
    turn = (turn + math.pi) % (2 * math.pi) - math.pi
    v, w = float(scene.speed[0]), float(scene.speed[other])
    return CrashRecord(
        other=scene.ids[other],
        time=scene.time,
        x=float(scene.x[0]),
        y=float(scene.y[0]),
        relative_x=relative_x,
        relative_y=relative_y,
        relative_heading=turn,
        closing_speed=math.hypot(w * math.cos(turn) - v, w * math.sin(turn)),
        type=classify(relative_x, relative_y, turn),
        detected_by=detected_by,
    )
