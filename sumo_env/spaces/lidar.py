"""What the agent sees, as distances around it: highway-env's LidarObservation, as a function of a scene.

Points and directions are complex numbers here, x + iy.
"""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sumo_env.config import LIDAR, ConfigError, whole_number
from sumo_env.spaces.actions import Situation

MOST_CELLS = 1000


class Lidar:
    """highway-env's `LidarObservation`: what is nearest in equal sectors around the ego.

    A sector has a distance [m], along the ray in its middle to the first rectangle of a vehicle or an obstacle, or
    less, where the centre of one is in the sector: to that, less half of its width. And it has the velocity of that one
    relative to the ego, along the ray [m/s]. Both are `maximum_range` where there is nothing; `normalize` divides both
    by it. The first ray points along x, the next ones turn towards y.
    """

    def __init__(self, config: Mapping[str, Any], *, own_axes: bool = False) -> None:
        """Make an entry ``observation``. Raises ConfigError: the number of cells or the range makes no sense.

        own_axes: whether x is ahead of the ego, and y to its right.
        """
        given = {**LIDAR, **config}
        self.cells = whole_number("observation 'cells'", given["cells"], MOST_CELLS)
        self.maximum_range, self.normalize = given["maximum_range"], bool(given["normalize"])
        if not self.maximum_range > 0:
            raise ConfigError(f"observation 'maximum_range' must be above 0 m, not {self.maximum_range!r}")
        high = 1.0 if self.normalize else self.maximum_range
        self.space = spaces.Box(-high, high, (self.cells, 2), np.float32)
        self._own_axes = own_axes
        self._angle = 2.0 * math.pi / self.cells  # [rad] of a sector
        self._rays = np.exp(1j * self._angle * np.arange(self.cells))

    def observe(self, seen: Situation) -> NDArray[np.float32]:
        """Distance and velocity by sector, float32 of shape (cells, 2)."""
        scene, table = seen.scene, np.full((self.cells, 2), self.maximum_range, np.float32)
        own = scene.heading[0] * self._own_axes
        ahead = np.exp(1j * (scene.heading - own))
        places = (scene.x - scene.x[0] + 1j * (scene.y - scene.y[0])) * np.exp(-1j * own)
        velocities = scene.speed * ahead
        near = 1 + np.flatnonzero(abs(places[1:]) <= self.maximum_range)
        if len(near):
            length, width = np.array([scene.size(scene.ids[row]) for row in near]).T
            distances = self._distances(places[near], ahead[near], length, width)
            centres = np.arange(len(near)), self._sectors(np.angle(places[near]))
            distances[centres] = np.minimum(distances[centres], abs(places[near]) - width / 2.0)
            first = len(near) - 1 - distances[::-1].argmin(axis=0)  # of equally far ones the last
            distance = distances[first, np.arange(self.cells)]
            velocity = _dot(velocities[near[first]] - velocities[0], self._rays)
            hit = distance <= self.maximum_range
            table[hit] = np.stack((distance, velocity), axis=1)[hit]
        return table / np.float32(self.maximum_range) if self.normalize else table

    def _distances(self, places: Any, ahead: Any, length: Any, width: Any) -> NDArray[np.float64]:
        """Distances [m] along the rays to rectangles that cover their sectors, else infinite; shape (n, cells)."""
        back, front, right = -length / 2.0, length / 2.0, 1j * width / 2.0
        corners = places + ahead * np.stack((back - right, back + right, front + right, front - right))
        with np.errstate(divide="ignore", invalid="ignore"):  # rays along a side
            strips = [self._strip(corners[0], corners[end]) for end in (1, 3)]
            enter, leave = np.maximum(strips[0][0], strips[1][0]), np.minimum(strips[0][1], strips[1][1])
            hit = np.maximum(enter, 0.0) <= np.minimum(leave, 1.0)
        return np.where(hit & self._covered(np.angle(corners)), enter * self.maximum_range, np.inf)

    def _strip(self, corner: Any, end: Any) -> Any:
        """Shares of the range at which the rays enter and leave the strip between the two sides across this one."""
        side = (end - corner) / abs(end - corner)
        rate = self.maximum_range * _dot(side[:, None], self._rays)
        ends = [_dot(point, side)[:, None] / rate for point in (corner, end)]
        return np.where(rate >= 0.0, ends, ends[::-1])

    def _sectors(self, angles: Any) -> Any:
        """The sectors of angles [rad]; a ray is in the middle of its sector."""
        return np.floor(angles / self._angle + 0.5).astype(int) % self.cells

    def _covered(self, angles: Any) -> Any:
        """Whether rectangles cover sectors, by the angles of their corners [rad], which have the shape (4, n).

        As in highway-env, a rectangle across the -x axis covers what lies between its two corners next to that axis.
        """
        low, high = angles.min(axis=0), angles.max(axis=0)
        limit = (math.pi - self._angle) / 2.0, (math.pi + self._angle) / 2.0
        across = (high > limit[0]) & (low < -limit[1])
        start, end = self._sectors(np.where(across, (high, low), (low, high)))[:, :, None]
        sector = np.arange(self.cells)
        return np.where(start < end, (start <= sector) & (sector <= end), (start <= sector) | (sector <= end))


def _dot(one: Any, other: Any) -> Any:
    """The scalar product."""
    return one.real * other.real + one.imag * other.imag
