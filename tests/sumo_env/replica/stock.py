"""highway-env's own roads and vehicles in random states, and the same states as records of the replica."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from highway_env.road.road import Road
from highway_env.vehicle.controller import MDPVehicle

from experiments.backends.highway_env import ENVIRONMENTS, ScenarioEnv
from sumo_env.replica.geometry import Places, locate, no_places
from sumo_env.replica.step import Rules
from sumo_env.replica.tables import CAR, NONE, Lanes, lanes_of

VARIANTS = ("path", "connected", "v0")
TASKS = tuple(ENVIRONMENTS)
GOALS = {
    "highway": (), "two-way": (), "roundabout": ("sxr", "exr", "nxr"), "intersection": ("o0", "o1", "o2", "o3"),
    "u-turn": ("d",),
}  # fmt: skip
NEAR = 120.0  # [m] of a lane that vehicles are put on, so that they meet


class Traffic(NamedTuple):
    """A road of highway-env's with vehicles, the ego first, and what the replica makes of it."""

    road: Road
    lanes: Lanes
    cars: np.ndarray
    places: Places
    rules: Rules

    @property
    def table(self) -> np.ndarray:
        return self.lanes.table


def environment(task: str, variant: str) -> ScenarioEnv:
    env = ENVIRONMENTS[task]({"variant": variant})
    env.reset(seed=0)
    return env


def traffic(env: ScenarioEnv, rng: np.random.Generator, count: int = 14) -> Traffic:
    """An ego and other drivers anywhere on their ways: some change lane, have crashed, or stop for others."""
    stock, task, variant = env.road, env.task.name, env.config["variant"]
    connected = stock.neighbour_vehicles_connected_lanes
    road = type(stock)(stock.network, neighbour_vehicles_connected_lanes=connected)
    names = list(stock.network.lanes_dict())
    wide = [name for name in names if stock.network.side_lanes(name)] or names  # where lanes can be changed
    for k in range(count):
        among = wide if rng.random() < 0.6 else names
        name = among[rng.integers(len(among))]
        lane = stock.network.get_lane(name)
        s = rng.uniform(-3.0, min(lane.length, NEAR) + 3.0)
        if lane.length < NEAR and rng.random() < 0.3:
            s = lane.length - rng.uniform(0.0, 6.0)  # where the next lane comes into play
        speed = rng.choice([rng.uniform(0.0, 30.0), rng.uniform(-2.0, 2.0), 45.0], p=[0.85, 0.12, 0.03])
        heading = lane.heading_at(s) + rng.normal() * 0.15
        kind = MDPVehicle if k == 0 else env._driver()
        vehicle = kind(road, lane.position(s, rng.normal() * 1.2), heading, speed)
        if k > 0:
            randomise(vehicle, rng)
        if GOALS[task]:
            vehicle.plan_route_to(str(rng.choice(GOALS[task])))
            if rng.random() < 0.4:  # has come from another road: the route asks for no lane any more
                vehicle.route[0] = (*vehicle.lane_index[:2], None)
            if rng.random() < 0.3:  # steers for the next lane already
                vehicle.target_lane_index = stock.network.next_lane(
                    vehicle.lane_index, vehicle.route, vehicle.position
                )
        beside = stock.network.side_lanes(vehicle.target_lane_index)
        if beside and rng.random() < 0.3:
            vehicle.target_lane_index = beside[rng.integers(len(beside))]
            vehicle._cuts_in = bool(rng.random() < 0.2) and k > 0
        vehicle.target_speed = rng.uniform(0.0, 32.0)
        vehicle.crashed = bool(rng.random() < 0.1)
        road.vehicles.append(vehicle)
    lanes = lanes_of(env.task.road(env.config), connected)
    cars = records(road, lanes)
    rules = Rules(
        connected and variant == "path", task == "two-way", 7 if task == "intersection" else 0, 1 / 15
    )
    places = no_places(lanes.table, cars)
    locate(lanes.table, cars, places, rules.loops)
    return Traffic(road, lanes, cars, places, rules)


def randomise(vehicle: Any, rng: np.random.Generator) -> None:
    """Give a driver parameters of its own."""
    a, b, d0, tau, delta, most, braking, gain = rng.uniform(
        [2, 2, 5.5, 0.3, 3.5, 5, 1, 0.05], [7, 7, 11, 2.0, 4.5, 9, 3, 0.4]
    )
    vehicle.COMFORT_ACC_MAX, vehicle.COMFORT_ACC_MIN, vehicle.DISTANCE_WANTED = a, -b, d0
    vehicle.TIME_WANTED, vehicle.DELTA, vehicle.ACC_MAX = tau, delta, most
    vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED, vehicle.LANE_CHANGE_MIN_ACC_GAIN = braking, gain
    vehicle.timer = rng.uniform(0.6, 1.6)
    vehicle.enable_lane_change = bool(rng.random() < 0.9)
    vehicle.gives_way = bool(rng.random() < 0.8)


def records(road: Road, lanes: Lanes) -> np.ndarray:
    """The vehicles of a road as records."""
    cars = np.zeros(len(road.vehicles), CAR)
    for k, (car, v) in enumerate(zip(cars, road.vehicles, strict=True)):
        car["number"], car["is_ego"] = k, isinstance(v, MDPVehicle)
        car["x"], car["y"] = v.position
        car["heading"], car["cos"], car["sin"] = v.heading, math.cos(v.heading), math.sin(v.heading)
        car["speed"], car["target_speed"], car["crashed"] = v.speed, v.target_speed, v.crashed
        car["lane"], car["target"] = lanes.numbers[v.lane_index], lanes.numbers[v.target_lane_index]
        car["route"], car["planned"] = NONE, NONE
        for leg, (start, end, lane) in enumerate(v.route or []):
            car["route"][leg] = lanes.numbers[start, end, 0]
            if leg == 0 and lane is not None:
                car["planned"] = lane
        car["steering"], car["acceleration"] = v.action["steering"], v.action["acceleration"]
        if v.impact is not None:
            car["is_pushed_apart"], (car["apart_x"], car["apart_y"]) = True, v.impact
        if not car["is_ego"]:
            car["timer"], car["changes_lanes"], car["is_forced"] = v.timer, v.enable_lane_change, v._cuts_in
            car["yields"], car["gives_way"] = getattr(v, "is_yielding", False), v.gives_way
            car["accel"], car["decel"], car["jam_distance"] = (
                v.COMFORT_ACC_MAX,
                -v.COMFORT_ACC_MIN,
                v.DISTANCE_WANTED,
            )
            car["tau"], car["delta"], car["acc_max"] = v.TIME_WANTED, v.DELTA, v.ACC_MAX
            car["safe_braking"] = v.LANE_CHANGE_MAX_BRAKING_IMPOSED
            car["min_gain"] = v.LANE_CHANGE_MIN_ACC_GAIN
    return cars


def close(ours: Any, theirs: Any) -> None:
    """Equal but for rounding; a test on a fixed state need not ask for equal bits."""
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
