"""What the agent sees: highway-env's Kinematics table and TimeToCollision grid, as functions of a scene."""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from operator import sub
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from sumo_env.config import KINEMATICS, MOST_VEHICLES, ConfigError, one_of, whole_number
from sumo_env.contacts.rectangles import state_of
from sumo_env.networks.lanes import wrap_to_pi
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.scene import (
    MAX_SPEED,
    ON_ITS_WAY,
    ON_REQUEST,
    PERCEPTION_DISTANCE,
    VEHICLE_LENGTH,
    Scene,
    is_obstacle,
)
from sumo_env.spaces.actions import Situation
from sumo_env.spaces.approach import APPROACH, RANGES, approach
from sumo_env.traffic.scenario import VehicleSpec

Array = NDArray[np.float32]
POSE = ("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h")
_DIRECTION, OFFSETS = ("cos_d", "sin_d"), ("long_off", "lat_off", "ang_off")
FEATURES = (*POSE, *_DIRECTION, *OFFSETS)
USUAL = POSE[:5]  # where none are named
RELATIVE = ("x", "y", "vx", "vy")  # to the ego, unless they are absolute
# [m] along the lane; what is further behind is seen by `see_behind`, obstacles never
BEHIND = -2.0 * VEHICLE_LENGTH


class TableForm(NamedTuple):
    """A Kinematics table in numbers, for Python and for kernels; arrays have shape (features,)."""

    features: Any  # places in FEATURES and, after them, APPROACH
    relative: Any  # whether a feature of the others is relative to the ego
    scale: Any  # of the affine map of a column, as `shift`: without a range, values stay as they are
    shift: Any
    low: Any  # of the clipping, as `high`
    high: Any
    rows: int  # of the table
    see_behind: bool
    has_obstacles: bool
    is_sorted: bool
    is_shuffled: bool
    origin: Any  # what is taken from the ego's own features


class Kinematics:
    """highway-env's `KinematicObservation`: one row per vehicle, the ego first, then the others by distance.

    Features with a range are mapped to [-1, 1]. The rows of the others are relative to the ego unless `absolute`. The
    features of `approach` are not highway-env's, and have ranges where the configuration gives none.
    """

    def __init__(self, config: Mapping[str, Any], side_lanes: int, *, on_its_way: bool = False) -> None:
        """Make the table of an entry ``observation``. Raises ConfigError: unknown feature, order or malformed range.

        side_lanes: lanes of the ego's first road, which sets the default range of y; on_its_way: whether there are the
        features `ON_ITS_WAY`, and the table is seen in the ego's axes: x ahead, y to its right, headings from its own
        (unless `absolute`).
        """
        given = {**KINEMATICS, **config}
        features = given["features"] or USUAL
        if not isinstance(features, list | tuple):
            raise ConfigError(f"observation 'features' must be a list of names, not {features!r}")
        known = (*FEATURES, *APPROACH, *((*ON_ITS_WAY, *ON_REQUEST) if on_its_way else ()))
        self.features = tuple(one_of("observation feature", feature, known) for feature in features)
        rows = whole_number("observation 'vehicles_count'", given["vehicles_count"], MOST_VEHICLES)
        usual = {
            "x": (-5.0 * MAX_SPEED, 5.0 * MAX_SPEED),
            "y": (-4.0 * side_lanes, 4.0 * side_lanes),
            "vx": (-2.0 * MAX_SPEED, 2.0 * MAX_SPEED),
            "vy": (-2.0 * MAX_SPEED, 2.0 * MAX_SPEED),
        }
        ranges = ranges_of(given["features_range"] or usual, known)
        self.ranges = {name: RANGES[name] for name in self.features if name in RANGES} | ranges
        self.absolute, self.observe_intentions = bool(given["absolute"]), bool(given["observe_intentions"])
        for key in ("vehicles_count", "order", "normalize", "clip", "see_behind"):
            setattr(self, key, given[key])  # as scripts read them of highway-env's type
        self.features_range = self.ranges
        columns = len(self.features)
        self.space = spaces.Box(-np.inf, np.inf, (rows, columns), np.float32)
        self._own_axes = on_its_way and not self.absolute
        self.form = TableForm(
            np.array([known.index(feature) for feature in self.features]),
            np.array([feature in RELATIVE and not self.absolute for feature in self.features]),
            *(np.ones(columns), np.zeros(columns), np.full(columns, -np.inf), np.full(columns, np.inf)),
            rows=rows,
            see_behind=bool(given["see_behind"]),
            has_obstacles=bool(given["include_obstacles"]),
            is_sorted=one_of("order", given["order"], ("sorted", "shuffled")) == "sorted",
            is_shuffled=given["order"] == "shuffled",
            origin=np.zeros(columns),
        )
        for column, feature in enumerate(self.features if given["normalize"] else ()):
            if feature in self.ranges:
                low, high = self.ranges[feature]
                self.form.scale[column] = 2.0 / (high - low)
                self.form.shift[column] = -1.0 - low * 2.0 / (high - low)
                if given["clip"]:
                    self.form.low[column], self.form.high[column] = -1.0, 1.0

    def visible(self, scene: Scene, road: Road, lane: LaneIndex) -> list[int]:
        """Rows of the scene in the order of the table, the ego's first.

        Distances are differences of longitudinal coordinates on the ego's lane, as in highway-env: projections
        on curved roads.
        """
        geometry = road.lane(lane)
        x, y = scene.x.tolist(), scene.y.tolist()
        here, _ = geometry.local_coordinates(x[0], y[0])
        furthest_behind = -math.inf if self.form.see_behind else BEHIND
        seen = []
        for row in range(1, len(x)):
            if math.hypot(x[row] - x[0], y[row] - y[0]) < PERCEPTION_DISTANCE:
                ahead = geometry.local_coordinates(x[row], y[row])[0] - here
                if is_obstacle(scene.ids[row]) and not (self.form.has_obstacles and ahead > BEHIND):
                    continue
                if ahead > furthest_behind:
                    seen.append((abs(ahead), row))
        if self.form.is_sorted:
            seen.sort()
        return [0, *[row for _, row in seen[: self.form.rows - 1]]]

    def observe(self, seen: Situation) -> Array:
        """The table, float32 of shape (vehicles_count, features), rows without a vehicle are zero."""
        rows = self.visible(seen.scene, seen.road, seen.ego.lane)
        columns = self.columns(seen, rows)
        values = np.array([columns[feature] for feature in self.features]).T
        form = self.form
        values[1:] -= values[0] * form.relative
        values[0] -= form.origin
        values *= form.scale
        values += form.shift
        np.maximum(values, form.low, out=values)
        np.minimum(values, form.high, out=values)
        table = np.zeros((form.rows, len(self.features)), np.float32)
        table[: len(rows)] = values
        if form.is_shuffled:
            seen.rng.shuffle(table[1:])
        return table

    def columns(self, seen: Situation, rows: list[int]) -> dict[str, Sequence[float]]:
        """Values of all features of these rows of the scene; plain floats, because the rows are few."""
        scene, road, specs = seen.scene, seen.road, seen.specs
        x, y, speed, heading = map(list, zip(*(state_of(scene, row) for row in rows), strict=True))
        own = heading[0]
        if self._own_axes:
            places = [_rotated(a - x[0], b - y[0], -own) for a, b in zip(x, y, strict=True)]
            x, y = [place[0] for place in places], [place[1] for place in places]
            heading = [wrap_to_pi(angle - own) for angle in heading]
        cos, sin = [math.cos(angle) for angle in heading], [math.sin(angle) for angle in heading]
        columns: dict[str, Sequence[float]] = {
            "presence": [1.0] * len(rows),
            "x": x,
            "y": y,
            "vx": [v * c for v, c in zip(speed, cos, strict=True)],
            "vy": [v * s for v, s in zip(speed, sin, strict=True)],
            "heading": heading,
            "cos_h": cos,
            "sin_h": sin,
        }
        if any(feature in _DIRECTION for feature in self.features):
            # the ego knows its own destination; those of the others are observed only with observe_intentions
            known = {row: specs.get(scene.ids[row]) for row in rows if row == 0 or self.observe_intentions}
            ends = [destination_direction(scene, road, row, known.get(row)) for row in rows]
            if self._own_axes:
                ends = [_rotated(*end, -own) for end in ends]
            columns["cos_d"], columns["sin_d"] = zip(*ends, strict=True)
        if any(feature in OFFSETS for feature in self.features):
            offsets = [self._offsets(scene, road, row) for row in rows]
            columns["long_off"], columns["lat_off"], columns["ang_off"] = zip(*offsets, strict=True)
        if any(feature in APPROACH for feature in self.features):
            ego, *others = zip(*(columns[name] for name in RELATIVE), strict=True)
            apart = (map(sub, other, ego) for other in (ego, *others))
            columns |= zip(APPROACH, zip(*(approach(*row) for row in apart), strict=True), strict=True)
        if any(feature in (*ON_ITS_WAY, *ON_REQUEST) for feature in self.features):
            nobody = [0.0] * (len(rows) - 1)
            columns |= {name: [value, *nobody] for name, value in on_its_way(scene).items()}
        return columns

    @staticmethod
    def _offsets(scene: Scene, road: Road, row: int) -> tuple[float, float, float]:
        x, y, _, heading = state_of(scene, row)
        lane = road.lane(road.closest_lane(x, y, heading))
        s, lateral = lane.local_coordinates(x, y)
        return s, lateral, wrap_to_pi(heading - lane.heading_at(s))


class ExitObservation(Kinematics):
    """highway-env's `ExitObservation`: the ego's own x is counted from where the lane begins that leads to the exit."""

    def __init__(self, config: Mapping[str, Any], side_lanes: int, road: Road) -> None:
        """As `Kinematics`. Raises ConfigError too for a road without the lane that highway-env looks for."""
        way = "1", "2"
        if (*way, 0) not in road.lanes:
            raise ConfigError(f"'ExitObservation' counts the way to an exit: the road {road.name!r} has none")
        lane = road.lane((*way, road.count(*way) - 1))
        super().__init__(config, side_lanes)
        self.form = self.form._replace(is_sorted=True)  # the nearest ones, in whatever order
        x, _ = lane.position(0.0, 0.0)
        self.form.origin[:] = [x * (feature == "x") for feature in self.features]


def _rotated(x: float, y: float, angle: float) -> tuple[float, float]:
    """A vector, turned by an angle from x towards y [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    return cos * x - sin * y, sin * x + cos * y


def on_its_way(scene: Scene) -> dict[str, float]:
    """Values of the ego for `ON_ITS_WAY`, and `ON_REQUEST`.

    A gap is 0 beside the ego, and to a lane to which it may not change.
    """
    place, light, speed = scene.place, scene.light, scene.speed.item(0)
    assert place is not None
    left_leader, left_follower, leader, _, right_leader, right_follower = place.neighbours
    gaps, closing = [], []
    for other, may, sign in (
        (leader, True, 1.0),
        (left_leader, place.left, 1.0),
        (left_follower, place.left, -1.0),
        (right_leader, place.right, 1.0),
        (right_follower, place.right, -1.0),
    ):
        gaps.append(max(other.gap, 0.0) if may else 0.0)
        closing.append(sign * (speed - other.speed) if other.id else 0.0)
    ends = (place.free, place.free_left, place.free_right)
    all_distances = (*ends, light.distance, *gaps, place.foe.gap)
    *distances, foe_gap = (min(distance, PERCEPTION_DISTANCE) for distance in all_distances)
    values = (*distances[:3], float(light.state), *distances[3:], *closing)
    asked_for = (light.seconds, foe_gap, place.foe.speed, place.target_speed)
    return dict(zip((*ON_ITS_WAY, *ON_REQUEST), (*values, *asked_for), strict=True))


def ranges_of(given: Any, known: tuple[str, ...] = FEATURES) -> dict[str, tuple[float, float]]:
    """Ranges of features that can be mapped to [-1, 1]."""
    try:
        ranges = {name: (float(low), float(high)) for name, (low, high) in given.items()}
        is_right = all(low < high for low, high in ranges.values())
    except (AttributeError, TypeError, ValueError):
        is_right = False
    if not is_right:
        raise ConfigError(f"observation 'features_range' needs rising [low, high] by feature, not {given!r}")
    return {one_of("feature in 'features_range':", name, known): limits for name, limits in ranges.items()}


def destination_direction(
    scene: Scene, road: Road, row: int, spec: VehicleSpec | None
) -> tuple[float, float]:
    """Unit vector from a vehicle to the end of its route (``Vehicle.destination_direction``).

    The end is that of the last road's left lane, or of the lane where a vehicle started that was on that road
    already; (0, 0) without a route and once it has been driven.
    """
    if spec is None or spec.destination is None:
        return 0.0, 0.0
    goal = spec.destination
    at_goal = spec.lane[1] == goal
    lane = road.lane(spec.lane if at_goal else next(index for index in road.lanes if index[1] == goal))
    x, y, _, _ = state_of(scene, row)
    s, lateral = lane.local_coordinates(x, y)
    if s > lane.length - VEHICLE_LENGTH / 2 and abs(lateral) <= lane.width:
        return 0.0, 0.0
    goal_x, goal_y = lane.position(lane.length, 0.0)
    distance = math.hypot(goal_x - x, goal_y - y)
    return (goal_x - x) / distance, (goal_y - y) / distance


class TimeToCollision:
    """highway-env's `TimeToCollisionObservation`: predicted contact over ego speeds, lanes and time.

    Shape (3, 3, horizon * policy_frequency): the ego's target speed +-1, its lane +-1, time steps of one policy step.
    1 at a predicted contact, 0.5 within a vehicle's length of it.
    """

    def __init__(self, config: Mapping[str, Any], policy_frequency: float) -> None:
        self.horizon = float(config.get("horizon", 10))
        self.quantum = 1.0 / policy_frequency
        self.steps = int(self.horizon / self.quantum)
        if self.steps < 1:
            raise ConfigError(f"observation 'horizon' must be a policy step at least, not {self.horizon!r} s")
        self.space = spaces.Box(0.0, 1.0, (3, 3, self.steps), np.float32)

    def observe(self, seen: Situation) -> Array:
        """The grid, float32 of shape (3, 3, steps)."""
        scene, road, ego = seen[:3]
        # what is left of the route begins with the road that is steered for (`ControlledVehicle.follow_road`)
        roads = [(start, end, 0) for start, end in pairwise(seen.route)]
        target = (*ego.target_lane[:2], 0)
        ahead = roads[roads.index(target) :] if target in roads else []
        lanes = road.count(*ego.lane[:2])
        grid = np.zeros((len(seen.target_speeds), lanes, self.steps))
        geometry = road.lane(ego.lane)
        here = geometry.local_coordinates(*state_of(scene, 0)[:2])[0]
        for row in range(1, len(scene)):
            if is_obstacle(scene.ids[row]):
                continue
            x, y, speed, heading = state_of(scene, row)
            projected = speed * math.cos(heading - ego.heading)
            distance = geometry.local_coordinates(x, y)[0] - here
            fastest = max(abs(own - projected) for own in seen.target_speeds)
            if abs(distance) - VEHICLE_LENGTH > (fastest + 1e-2) * self.horizon:
                continue  # there is no contact before the horizon
            other_lane = road.closest_lane(x, y, heading)
            if not _connected(road, ego.lane, other_lane, ahead):
                continue
            same_width = road.count(*other_lane[:2]) == lanes
            columns = [other_lane[2]] if same_width else list(range(lanes))
            for k, own in enumerate(seen.target_speeds):
                if own == speed:
                    continue
                closing = own - projected
                if abs(closing) < 1e-2:  # highway_env.utils.not_zero
                    closing = math.copysign(1e-2, closing)
                for margin, cost in ((0.0, 1.0), (-VEHICLE_LENGTH, 0.5), (VEHICLE_LENGTH, 0.5)):
                    time = (distance + margin) / closing
                    if time < 0:
                        continue
                    for step in (int(time / self.quantum), math.ceil(time / self.quantum)):
                        if step < self.steps:
                            for column in columns:
                                grid[k, column, step] = max(grid[k, column, step], cost)
        return self._window(grid, ego.lane[2], ego.speed_index)

    def _window(self, grid: NDArray[np.float64], lane: int, speed_index: int) -> Array:
        """The 3 x 3 neighbourhood: beyond the outer lanes all is contact, beyond the last speed the speed repeats."""
        wall = np.ones((grid.shape[0], 1, grid.shape[2]))
        padded = np.concatenate([wall, grid, wall], axis=1)[:, lane : lane + 3, :]
        near = np.clip(np.arange(speed_index - 1, speed_index + 2), 0, grid.shape[0] - 1)
        return padded[near].astype(np.float32)


def _connected(
    road: Road, start: LaneIndex, other: LaneIndex, route: Sequence[LaneIndex], depth: int = 3
) -> bool:
    """Whether `other` is on the road of `start`, leads to it, or the like of a road ahead.

    ``RoadNetwork.is_connected_road``: up to `depth` roads ahead are looked at, along the `route` where it goes on
    from here and on all branches where it does not.
    """
    if start[:2] == other[:2] or other[1] == start[0]:
        return True
    if depth == 0:
        return False
    if route and route[0][:2] == start[:2]:
        return _connected(road, start, other, route[1:], depth)
    if route and route[0][0] == start[1]:
        return _connected(road, route[0], other, route[1:], depth - 1)
    return any(
        _connected(road, (start[1], end, 0), other, route, depth - 1)
        for end in road.successors.get(start[1], ())
    )
