"""What the agent sees, as a picture: highway-env's OccupancyGrid, as a function of a scene."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sumo_env.config import OCCUPANCY_GRID, ConfigError, one_of
from sumo_env.networks.roads import Road
from sumo_env.scene import MAX_SPEED, Scene, is_obstacle
from sumo_env.spaces.actions import Situation
from sumo_env.spaces.observation import FEATURES, RELATIVE, Kinematics, ranges_of

ON_ROAD = "on_road"
AROUND = 100.0  # [m] along each lane, either way, as far as the road is drawn
LARGEST = 1000  # cells along an axis


class OccupancyGrid:
    """highway-env's `OccupancyGridObservation`: cells around the ego, one layer a feature.

    A cell has the values of the vehicle whose centre is in it (of several, of the first in the scene), relative to the
    ego, and 1 in the layer on_road where a lane is; all else is 0.
    """

    def __init__(self, config: Mapping[str, Any]) -> None:
        """Raises ConfigError: an unknown feature, a malformed grid or range."""
        given = {**OCCUPANCY_GRID, **config}
        features = given["features"] or ("presence", "vx", "vy", ON_ROAD)
        if not isinstance(features, list | tuple):
            raise ConfigError(f"observation 'features' must be a list of names, not {features!r}")
        known = (*FEATURES, ON_ROAD)
        self.features = tuple(one_of("observation feature", feature, known) for feature in features)
        if given["absolute"]:
            raise ConfigError("'absolute' of an OccupancyGrid can only be False, as in highway-env")
        shape = [0, 0]
        try:
            self.size = np.array(given["grid_size"] or [[-27.5, 27.5], [-27.5, 27.5]], float)
            self.step = np.array(given["grid_step"] or [5, 5], float)
            if self.size.shape == (2, 2) and self.step.shape == (2,) and (self.step > 0).all():
                shape = [int(count) for count in (self.size[:, 1] - self.size[:, 0]) / self.step]
        except (TypeError, ValueError, IndexError, OverflowError):
            pass
        if not 1 <= min(shape) <= max(shape) <= LARGEST:
            raise ConfigError(
                "observation 'grid_size' must be [[min_x, max_x], [min_y, max_y]] and 'grid_step' [step_x, step_y], "
                f"with 1 to {LARGEST} cells each way [m]: {given['grid_size']!r}, {given['grid_step']!r}"
            )
        self.shape = (len(self.features), *shape)
        twice = 2.0 * MAX_SPEED
        self.ranges = ranges_of(given["features_range"] or {"vx": (-twice, twice), "vy": (-twice, twice)})
        self._aligned, self._clip = bool(given["align_to_vehicle_axes"]), bool(given["clip"])
        self._is_image = bool(given["as_image"])
        self.space: Any = (
            spaces.Box(0, 255, self.shape, np.uint8)
            if self._is_image
            else spaces.Box(-np.inf, np.inf, self.shape, np.float32)
        )
        named = [*{"x", "y", *self.features} - {ON_ROAD}]
        self._table = Kinematics({"features": named, "observe_intentions": True}, 1)

    def observe(self, seen: Situation) -> NDArray[Any]:
        """The grid, float32 (or uint8 `as_image`) of shape (features, cells along x, cells along y)."""
        scene, road, before_ego = seen.scene, seen.road, seen.before_ego
        rows = [row for row, name in enumerate(scene.ids) if not is_obstacle(name)]
        columns = self._table.columns(seen, rows)
        x, y = np.array(columns["x"]), np.array(columns["y"])
        cells, inside = self._cells(scene, x - x[0], y - y[0])
        order = [*range(1, before_ego + 1), 0, *range(before_ego + 1, len(rows))]
        grid = np.full(self.shape, np.nan)
        for layer, feature in enumerate(self.features):
            if feature == ON_ROAD:
                self._draw_road(grid[layer], scene, road)
                continue
            values = np.array(columns[feature], float)
            if feature in RELATIVE:
                values = values - values[0]
            if feature in self.ranges:
                low, high = self.ranges[feature]
                values = -1.0 + (values - low) * 2.0 / (high - low)
            for row in reversed(order):
                if inside[row]:
                    grid[layer, *cells[:, row]] = values[row]
        if self._clip or self._is_image:
            grid = np.clip(grid, -1.0, 1.0)
        if self._is_image:  # 0 is 127 here, and nothing is 0
            return np.nan_to_num((grid + 1.0) / 2.0 * 255.0).astype(np.uint8)
        return np.nan_to_num(grid).astype(np.float32)

    def _cells(self, scene: Scene, dx: Any, dy: Any) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """The cells of points at (dx, dy) [m] from the ego, shape (2, n), and whether they are inside the grid."""
        if self._aligned:
            heading = float(scene.heading[0])
            c, s = math.cos(heading), math.sin(heading)
            dx, dy = c * dx + s * dy, c * dy - s * dx
        cells = np.floor((np.array((dx, dy)) - self.size[:, :1]) / self.step[:, None]).astype(np.int64)
        return cells, ((cells >= 0) & (cells < np.array(self.shape[1:])[:, None])).all(axis=0)

    def _draw_road(self, layer: NDArray[np.float64], scene: Scene, road: Road) -> None:
        """Write 1 where points of a lane's middle are (``fill_road_layer_by_lanes``)."""
        x, y = float(scene.x[0]), float(scene.y[0])
        points: list[tuple[float, float]] = []
        for lane in map(road.lane, road.lanes_near(x, y, math.hypot(*np.abs(self.size).max(axis=1)))):
            here = lane.local_coordinates(x, y)[0]
            places = np.arange(here - AROUND, here + AROUND, self.step.min()).clip(0.0, lane.length)
            points += [lane.position(s, 0.0) for s in places.tolist()]
        (first, second), inside = self._cells(scene, *(np.array(points).reshape(-1, 2) - (x, y)).T)
        layer[first[inside], second[inside]] = 1.0
