"""highway-env faster, with the same result: its two searches and its pair test, compiled.

Reference episodes cost 10 to 1000 times those of SUMO. Most of that time goes into projecting vehicles on lanes;
here the projections are `sumo_env.models.lane_table`'s, which equal highway-env's to rounding. Tested against the
original, vehicle for vehicle (tests/experiments/test_validation.py).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import Road

from networks import roads
from sumo_env.compiled import compiled
from sumo_env.config import Config
from sumo_env.models.lane_table import LENGTH, LaneTable, heading_at, lane_table, local_coordinates
from sumo_env.scenario import Scenario
from sumo_env.tasks import get_task
from sumo_env.tasks.base import Task

VEHICLE_LENGTH = 5.0  # AbstractLane.VEHICLE_LENGTH [m]
NEAR = 3.0  # [m] from the centre line, half a lane's width and a margin of 1 m
REACH = math.sqrt(29.0)  # [m] RoadObject.diagonal


@compiled
def closest(geometry: Any, x: float, y: float, heading: float) -> int:
    """``RoadNetwork.get_closest_lane_index``: number of the lane; a heading of nan counts nothing."""
    best, best_distance = 0, math.inf
    for lane in range(len(geometry)):
        s, lat = local_coordinates(geometry, lane, x, y)
        distance = abs(lat) + max(s - geometry[lane, LENGTH], 0.0) + max(-s, 0.0)
        if not math.isnan(heading):
            angle = heading - heading_at(geometry, lane, s)
            distance += abs((angle + math.pi) % (2.0 * math.pi) - math.pi)
        if distance < best_distance:
            best, best_distance = lane, distance
    return best


@compiled
def neighbours(geometry: Any, lanes: Any, offsets: Any, x: Any, y: Any, i: int) -> tuple[int, int]:
    """``Road.neighbour_vehicles``: rows of the vehicles ahead of and behind row `i`; -1 for none.

    lanes, offsets: the lane looked at and those joined to it, shape (k,), with where they begin [m].
    """
    front, rear = -1, -1
    s_front, s_rear = math.inf, -math.inf
    s_own = local_coordinates(geometry, lanes[0], x[i], y[i])[0]
    for j in range(len(x)):
        if j == i:
            continue
        for k in range(len(lanes)):
            s, lat = local_coordinates(geometry, lanes[k], x[j], y[j])
            if abs(lat) > NEAR or not -VEHICLE_LENGTH <= s < geometry[lanes[k], LENGTH] + VEHICLE_LENGTH:
                continue
            s += offsets[k]
            if s_own <= s <= s_front:
                s_front, front = s, j
            if s_rear < s < s_own:
                s_rear, rear = s, j
            break
    return front, rear


@compiled
def near_pairs(x: Any, y: Any, speed: Any, dt: float) -> Any:
    """Pairs (i, j), i < j, that pass ``RoadObject._is_colliding``'s first test, in order; shape (pairs, 2)."""
    found = []
    for i in range(len(x)):
        reach = REACH + speed[i] * dt + 1e-9
        for j in range(i + 1, len(x)):
            if math.hypot(x[j] - x[i], y[j] - y[i]) <= reach:
                found.append((i, j))
    result = np.empty((len(found), 2), np.int64)
    for k, pair in enumerate(found):
        result[k, 0], result[k, 1] = pair
    return result


class FastRoad(Road):
    """A road whose searches are compiled; `table` and `joined` are set by `accelerate`."""

    table: LaneTable
    joined: dict[Any, tuple[Any, Any]]
    _rows: dict[int, int] | None = None

    def act(self) -> None:
        """``Road.act``; nobody moves meanwhile, so positions are gathered once."""
        self._gather()
        super().act()
        self._rows = None

    def _gather(self) -> None:
        self._rows = {id(vehicle): row for row, vehicle in enumerate(self.vehicles)}
        positions = np.array([vehicle.position for vehicle in self.vehicles])
        self._x, self._y = np.ascontiguousarray(positions[:, 0]), np.ascontiguousarray(positions[:, 1])

    def neighbour_vehicles(self, vehicle: Any, lane_index: Any = None) -> tuple[Any, Any]:
        """``Road.neighbour_vehicles``."""
        lane_index = lane_index or vehicle.lane_index
        if self._rows is None or id(vehicle) not in self._rows or lane_index not in self.table.index:
            return super().neighbour_vehicles(vehicle, lane_index)
        if lane_index not in self.joined:
            self.joined[lane_index] = self._join(lane_index)
        front, rear = neighbours(
            self.table.geometry, *self.joined[lane_index], self._x, self._y, self._rows[id(vehicle)]
        )
        return (
            None if front < 0 else self.vehicles[front],
            None if rear < 0 else self.vehicles[rear],
        )

    def _join(self, lane_index: Any) -> tuple[Any, Any]:
        """The lane and, with connected lanes, those after and before it, as ``Road.neighbour_vehicles`` lists them."""
        start, end, i = lane_index
        lanes, offsets = [self.table.index[lane_index]], [0.0]
        if self.neighbour_vehicles_connected_lanes:
            graph = self.network.graph
            for node, following in graph.get(end, {}).items():
                lanes.append(self.table.index[end, node, i if i < len(following) else 0])
                offsets.append(graph[start][end][i].length)
            for node, ends in graph.items():
                if start in ends:
                    before = (node, start, i if i < len(ends[start]) else 0)
                    lanes.append(self.table.index[before])
                    offsets.append(-ends[start][before[2]].length)
        return np.array(lanes), np.array(offsets)

    def step(self, dt: float) -> None:
        """``Road.step``; cars too far apart to touch are not asked."""
        if isinstance(self, RegulatedRoad) or self.objects:
            super().step(dt)
            return
        for vehicle in self.vehicles:
            vehicle.step(dt)
        self._gather()
        self._rows = None
        speed = np.array([float(vehicle.speed) for vehicle in self.vehicles])
        for i, j in near_pairs(self._x, self._y, speed, dt).tolist():
            self.vehicles[i].handle_collisions(self.vehicles[j], dt)


def within_reach(name: str) -> Task:
    """A task whose scenarios lack the vehicles that the ego cannot reach, as SUMO leaves them out."""

    class WithinReach(type(get_task(name))):  # type: ignore[misc]
        def scenario(self, config: Config, seed: int) -> Scenario:
            drawn = super().scenario(config, seed)
            near = tuple(v for v in drawn.vehicles if self.concerns_ego(v, drawn.ego, config))
            return replace(drawn, vehicles=near)

    return WithinReach()


def accelerate(env: Any, task: str) -> None:
    """Make a `experiments.backends.highway_env` environment use the compiled searches from its next reset on."""
    method = "_make_road" if hasattr(env, "_make_road") else "_create_road"  # its name on the highway
    make_road = getattr(env, method)

    def make_fast_road(*args: Any, **kwargs: Any) -> None:
        make_road(*args, **kwargs)
        road = env.road
        if task == "highway":
            lanes = roads.highway(int(env.config["lanes_count"])).lanes
        elif task == "two-way":
            lanes = roads.two_way(float(env.config["road_length"])).lanes
        else:
            lanes = roads.ROADS[task]().lanes
        road.__class__ = type("Fast" + type(road).__name__, (FastRoad, type(road)), {})
        road.table, road.joined = lane_table(lanes), {}
        network = road.network
        names = list(road.table.index)
        assert names == list(network.lanes_dict()), "lanes in another order"
        geometry = road.table.geometry

        def get_closest_lane_index(position: Any, heading: float | None = None) -> Any:
            x, y = float(position[0]), float(position[1])
            return names[closest(geometry, x, y, math.nan if heading is None else float(heading))]

        network.get_closest_lane_index = get_closest_lane_index

    setattr(env, method, make_fast_road)
