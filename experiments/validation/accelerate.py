"""highway-env faster, with the same result to the last bit: all vehicles of a road at once, compiled.

highway-env asks vehicle after vehicle and multiplies arrays of two numbers to do so. Here a road gathers the numbers
of its vehicles into arrays, `kernels` and `contacts` compute what they do, and the road hands it back: where each
steers, how it accelerates, where it moves, which of them collide or get into each other's way. What seldom happens (a
lane change, the next road, a wreck's way, a swerve) stays highway-env's code. Tested against the original, step for
step (tests/experiments/test_accelerate.py).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from highway_env.envs.common.observation import KinematicObservation
from highway_env.road.lane import StraightLane
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import Road
from highway_env.utils import not_zero
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from experiments.backends.highway_env_vehicle import PathVehicle, ScenarioVehicle
from experiments.validation import contacts, kernels
from experiments.validation.kernels import Lanes
from sumo_env.config import Config
from sumo_env.models.lane_table import LIMIT
from sumo_env.scenario import Scenario
from sumo_env.tasks import get_task
from sumo_env.tasks.base import Task

FEATURES = {"presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h"}  # that `FastObservation` knows


class FastRoad(Road):
    """A road that decides and moves for all its vehicles at once; `lanes` is set by `accelerate`."""

    lanes: Lanes
    _rows: dict[int, int] | None = None  # id of a vehicle -> its row, while nobody moves
    _known: list[Vehicle] | None = None

    def _gather(self) -> None:
        vehicles = self.vehicles
        if self._known != vehicles:
            self._know()
        positions = np.concatenate([vehicle.position for vehicle in vehicles]).reshape(-1, 2)
        self._x, self._y = np.ascontiguousarray(positions[:, 0]), np.ascontiguousarray(positions[:, 1])
        self._heading = np.array([vehicle.heading for vehicle in vehicles], float)
        self._speed = np.array([vehicle.speed for vehicle in vehicles], float)

    def _know(self) -> None:
        """What does not change as long as the same vehicles are there."""
        self._known = list(self.vehicles)
        self._drives = [isinstance(vehicle, ScenarioVehicle) for vehicle in self.vehicles]
        if not all(d or type(v) is MDPVehicle for d, v in zip(self._drives, self.vehicles, strict=True)):
            raise TypeError("only the ego and vehicles of a scenario can be driven here")
        self._along_path = np.array([isinstance(vehicle, PathVehicle) for vehicle in self.vehicles])
        numbers = [
            (v.COMFORT_ACC_MAX, -v.COMFORT_ACC_MAX * v.COMFORT_ACC_MIN, v.DISTANCE_WANTED, v.TIME_WANTED, v.DELTA,
             v.ACC_MAX) if drives else (1.0,) * 6
            for v, drives in zip(self.vehicles, self._drives, strict=True)
        ]  # fmt: skip
        self._comfort, product, self._min_gap, self._headway, self._delta, self._most = np.array(
            numbers
        ).T.copy()
        self._root = 2 * np.sqrt(product)

    def act(self) -> None:
        """``Road.act``: nobody moves meanwhile; lane changes are decided in turn, as they depend on each other."""
        vehicles, index = self.vehicles, self.lanes.index
        self._gather()
        self._rows = {id(vehicle): row for row, vehicle in enumerate(vehicles)}
        targets = [index[vehicle.target_lane_index] for vehicle in vehicles]
        geometry = self.lanes.geometry
        at_end = kernels.after_end(geometry, np.array(targets), self._x, self._y).tolist()
        for row, vehicle in enumerate(vehicles):
            if self._drives[row] and vehicle.crashed:
                continue
            if at_end[row]:
                vehicle.follow_road()
            if self._drives[row] and vehicle.enable_lane_change and _may_change(vehicle):
                vehicle.change_lane_policy()
            targets[row] = index[vehicle.target_lane_index]
        self._rows = None
        own = np.array([index[vehicle.lane_index] for vehicle in vehicles])
        numbers = np.array(targets)
        angles = kernels.steering(geometry, numbers, self._x, self._y, self._heading, self._speed)
        accelerations = self._accelerations(own, numbers)
        for vehicle, drives, angle, acceleration in zip(
            vehicles, self._drives, angles.tolist(), accelerations, strict=True
        ):
            if not drives:
                acceleration = vehicle.speed_control(vehicle.target_speed)
            vehicle.action = {"steering": angle, "acceleration": acceleration}

    def _accelerations(self, own: Any, targets: Any) -> list[float]:
        """``IDMVehicle.act``: what IDM wants behind the leader, and behind that on the target lane [m/s2]."""
        lanes = self.lanes
        wanted = np.array([vehicle.target_speed for vehicle in self.vehicles], float)
        base = kernels.speed_ratios(self._speed, wanted, lanes.geometry[own, LIMIT])
        free = self._comfort * (1 - np.power(base, self._delta))
        leader, is_beyond, begin, *points = kernels.leaders(
            lanes.geometry, lanes.road, lanes.following, lanes.searched, lanes.offsets, self._x, self._y, own,
            targets, self._along_path,
        )  # fmt: skip
        places, _ = kernels.project(lanes.geometry, *points)
        ratio = kernels.gap_ratios(
            leader,
            is_beyond,
            begin,
            places,
            self._heading,
            self._speed,
            self._min_gap,
            self._headway,
            self._root,
        )
        square = ratio * ratio
        for row in np.flatnonzero(is_beyond).tolist():
            square[row] = float(ratio[row]) ** 2  # a power of the C library, which may end in another bit
        result: list[float] = kernels.behind_both(free, self._comfort, square, self._most).tolist()
        return result

    def neighbour_vehicles(self, vehicle: Any, lane_index: Any = None) -> tuple[Any, Any]:
        """``Road.neighbour_vehicles``."""
        lane = self.lanes.index.get(lane_index or vehicle.lane_index)
        if self._rows is None or id(vehicle) not in self._rows or lane is None:
            return super().neighbour_vehicles(vehicle, lane_index)
        lanes, row = self.lanes, self._rows[id(vehicle)]
        front, rear = kernels.neighbours(
            lanes.geometry, lanes.searched, lanes.offsets, self._x, self._y, row, lane
        )
        return (
            None if front < 0 else self.vehicles[front],
            None if rear < 0 else self.vehicles[rear],
        )

    def step(self, dt: float) -> None:
        """``Road.step``, with ``RoadObject.handle_collisions`` of all pairs at once."""
        self._gather()
        vehicles, lanes = self.vehicles, self.lanes
        actions = [vehicle.action for vehicle in vehicles]
        angle = np.array([action["steering"] for action in actions], float)
        acceleration = np.array([action["acceleration"] for action in actions], float)
        slip = np.arctan(1 / 2 * np.tan(angle))
        way = self._heading + slip
        x, y = self._x + self._speed * np.cos(way) * dt, self._y + self._speed * np.sin(way) * dt
        heading = self._heading + self._speed * np.sin(slip) / (kernels.VEHICLE_LENGTH / 2) * dt
        speed = self._speed + acceleration * dt
        closest = kernels.closest_of_all(lanes.geometry, x, y, heading).tolist()
        headings, speeds = heading.tolist(), speed.tolist()
        positions = np.empty((len(x), 2))
        positions[:, 0], positions[:, 1] = x, y
        for row, (vehicle, position) in enumerate(zip(vehicles, positions, strict=True)):
            if _is_special(vehicle):
                vehicle.step(dt)
                x[row], y[row] = vehicle.position
                heading[row], speed[row] = vehicle.heading, vehicle.speed
                continue
            if self._drives[row]:
                vehicle.timer += dt
            vehicle.position, vehicle.heading, vehicle.speed = position, headings[row], speeds[row]
            vehicle.lane_index, vehicle.lane = lanes.names[closest[row]], lanes.lanes[closest[row]]
        pairs, touching, ways = contacts.collisions(x, y, heading, speed, dt)
        for (i, j), now, way in zip(pairs.tolist(), touching.tolist(), ways, strict=True):
            if not math.isnan(way[0]):
                vehicles[i].impact, vehicles[j].impact = way / 2, -way / 2
            if now:
                vehicles[i].crashed = vehicles[j].crashed = True


class FastRegulatedRoad(RegulatedRoad, FastRoad):
    """The intersection's road; the rule of way asks only those who are in each other's way."""

    def enforce_road_rules(self) -> None:
        """``RegulatedRoad.enforce_road_rules``."""
        found = self.conflicts()
        rows = {id(vehicle): row for row, vehicle in enumerate(self.vehicles)}
        self.is_conflict_possible = lambda v1, v2: found[rows[id(v1)], rows[id(v2)]]
        super().enforce_road_rules()

    def conflicts(self) -> Any:
        """``is_conflict_possible`` of each vehicle and those after it, shape (n, n)."""
        self._gather()
        index, routes = self.lanes.index, []
        for vehicle in self.vehicles:
            lane = vehicle.lane_index
            routes.append(
                [index[start, end, lane[2] if i is None else i] for start, end, i in vehicle.route or [lane]]
            )
        return contacts.conflicts(
            self.lanes.geometry, kernels.padded(routes),
            np.array([index[vehicle.lane_index] for vehicle in self.vehicles]), self._x, self._y, self._speed,
        )  # fmt: skip


def _may_change(vehicle: ScenarioVehicle) -> bool:
    """Whether ``change_lane_policy`` would do anything."""
    return bool(
        vehicle._cuts_in
        or vehicle.timer > vehicle.LANE_CHANGE_DELAY
        or vehicle.lane_index != vehicle.target_lane_index
    )


def _is_special(vehicle: Any) -> bool:
    """Whether ``Vehicle.step`` does more than move the vehicle."""
    return (
        vehicle.crashed
        or vehicle.impact is not None
        or not vehicle.MIN_SPEED <= vehicle.speed <= vehicle.MAX_SPEED
        or getattr(vehicle, "_swerve_left", 0.0) > 0.0
    )


class FastIDM(IDMVehicle):
    """IDM without arrays; what MOBIL asks many times."""

    def acceleration(
        self, ego_vehicle: Any, front_vehicle: Vehicle | None = None, rear_vehicle: Vehicle | None = None
    ) -> float:
        """``IDMVehicle.acceleration`` [m/s2]."""
        if not ego_vehicle:
            return 0.0
        wanted = not_zero(min(max(ego_vehicle.target_speed, 0.0), ego_vehicle.lane.speed_limit))
        base = max(ego_vehicle.speed, 0.0) / abs(wanted)
        acceleration = self.COMFORT_ACC_MAX * (1 - float(np.power(base, self.DELTA)))
        if front_vehicle:
            ratio = self.desired_gap(ego_vehicle, front_vehicle) / not_zero(
                ego_vehicle.lane_distance_to(front_vehicle)
            )
            acceleration -= self.COMFORT_ACC_MAX * (ratio * ratio)
        return acceleration

    def desired_gap(self, ego_vehicle: Any, front_vehicle: Any = None, projected: bool = True) -> float:
        """``IDMVehicle.desired_gap`` [m]."""
        speed, other = ego_vehicle.speed, front_vehicle.speed
        faster = speed - other
        if projected:
            heading, turned = ego_vehicle.heading, front_vehicle.heading
            cos, sin = math.cos(heading), math.sin(heading)
            faster = (speed * cos - other * math.cos(turned)) * cos + (
                speed * sin - other * math.sin(turned)
            ) * sin
        root = math.sqrt(-self.COMFORT_ACC_MAX * self.COMFORT_ACC_MIN)
        return float(self.DISTANCE_WANTED + speed * self.TIME_WANTED + speed * faster / (2 * root))


class FastScenarioVehicle(ScenarioVehicle, FastIDM):
    """`ScenarioVehicle` without arrays."""


class FastPathVehicle(PathVehicle, FastIDM):
    """`PathVehicle` without arrays."""


class FastStraightLane(StraightLane):
    """A straight lane that projects single points without arrays."""

    def local_coordinates(self, position: Any) -> tuple[float, float]:
        """``StraightLane.local_coordinates`` [m]."""
        x, y, cos, sin = self.numbers
        dx, dy = float(position[0]) - x, float(position[1]) - y
        return dx * cos + dy * sin, dy * cos - dx * sin


class FastObservation(KinematicObservation):
    """``KinematicObservation`` without data frames, which take longer than driving."""

    def observe(self) -> np.ndarray:
        """``KinematicObservation.observe``, shape (vehicles_count, features)."""
        ego = self.observer_vehicle
        close = self.env.road.close_objects_to(
            ego, self.env.PERCEPTION_DISTANCE, count=self.vehicles_count - 1, see_behind=self.see_behind,
            sort=self.order == "sorted", vehicles_only=not self.include_obstacles,
        )  # fmt: skip
        seen = [_features(ego), *map(_features, close)]
        columns = {name: np.array([row[name] for row in seen], float) for name in self.features}
        if not self.absolute:
            for name in columns.keys() & {"x", "y", "vx", "vy"}:
                columns[name][1:] -= columns[name][0]
        if self.normalize:
            columns = self.normalize_obs(columns)
        observation = np.zeros((self.vehicles_count, len(self.features)), np.float32)
        observation[: len(seen)] = np.stack([columns[name] for name in self.features], axis=1)
        return observation


def _features(vehicle: Any) -> dict[str, float]:
    """``Vehicle.to_dict``, the features that are asked for here."""
    cos, sin = math.cos(vehicle.heading), math.sin(vehicle.heading)
    return {
        "presence": 1.0, "x": vehicle.position[0], "y": vehicle.position[1], "vx": vehicle.speed * cos,
        "vy": vehicle.speed * sin, "heading": vehicle.heading, "cos_h": cos, "sin_h": sin,
    }  # fmt: skip


def within_reach(name: str) -> Task:
    """A task whose scenarios lack the vehicles that the ego cannot reach, as SUMO leaves them out."""

    class WithinReach(type(get_task(name))):  # type: ignore[misc]
        def scenario(self, config: Config, seed: int) -> Scenario:
            drawn = super().scenario(config, seed)
            near = tuple(v for v in drawn.vehicles if self.concerns_ego(v, drawn.ego, config))
            return replace(drawn, vehicles=near)

    return WithinReach()


def accelerate(env: Any) -> None:
    """Make a `experiments.backends.highway_env` environment use the compiled code from its next reset on."""
    method = "_make_road" if hasattr(env, "_make_road") else "_create_road"  # its name on the highway
    make_road, driver, define_spaces = getattr(env, method), env._driver, env.define_spaces

    def make_fast_road(*args: Any, **kwargs: Any) -> None:
        make_road(*args, **kwargs)
        road = env.road
        road.__class__ = FastRegulatedRoad if isinstance(road, RegulatedRoad) else FastRoad
        for lane in road.network.lanes_list():
            if type(lane) is StraightLane:
                lane.__class__ = FastStraightLane
                lane.numbers = (*lane.start.tolist(), *lane.direction.tolist())
        road.lanes = lanes = Lanes.of(road.network, road.neighbour_vehicles_connected_lanes)

        def get_closest_lane_index(position: Any, heading: float | None = None) -> Any:
            x, y = float(position[0]), float(position[1])
            return lanes.names[
                kernels.closest(lanes.geometry, x, y, math.nan if heading is None else float(heading))
            ]

        road.network.get_closest_lane_index = get_closest_lane_index

    def fast_driver() -> type[ScenarioVehicle]:
        return FastPathVehicle if driver() is PathVehicle else FastScenarioVehicle

    def define_fast_spaces() -> None:
        define_spaces()
        observation = env.observation_type
        if type(observation) is KinematicObservation and set(observation.features) <= FEATURES:
            observation.__class__ = FastObservation

    setattr(env, method, make_fast_road)
    env._driver, env.define_spaces = fast_driver, define_fast_spaces
