"""highway-env's own roads and drivers, in random states, for the driver models to be compared with."""

from __future__ import annotations

import numpy as np
from highway_env.envs import IntersectionEnv
from highway_env.road.road import RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

from sumo_env.models.idm import accelerations_along
from sumo_env.models.lane_table import LaneTable, local_coordinates

LEAKED = ("DISTANCE_WANTED", "COMFORT_ACC_MAX", "COMFORT_ACC_MIN")


def intersection_network() -> RoadNetwork:
    """The lanes of highway-env's intersection; undoes what making it changes in the class of the drivers."""
    before = {name: getattr(IDMVehicle, name) for name in LEAKED}
    try:
        return IntersectionEnv().road.network
    finally:
        for name, value in before.items():
            setattr(IDMVehicle, name, value)


def randomise(vehicle: IDMVehicle, rng: np.random.Generator) -> np.ndarray:
    """Give a driver parameters of its own; returns its row in the table of drivers."""
    a, b, s0, tau, delta, clip = rng.uniform([2, 2, 5.5, 0.3, 3.5, 5], [7, 7, 11, 2.0, 4.5, 9])
    vehicle.COMFORT_ACC_MAX, vehicle.COMFORT_ACC_MIN, vehicle.DISTANCE_WANTED = a, -b, s0
    vehicle.TIME_WANTED, vehicle.DELTA, vehicle.ACC_MAX = tau, delta, clip
    return np.array([a, b, s0, tau, delta, clip])


def state(vehicles: list[Vehicle]) -> dict[str, np.ndarray]:
    """Positions, speeds, headings and desired speeds of vehicles as arrays."""
    return {
        "x": np.array([v.position[0] for v in vehicles]),
        "y": np.array([v.position[1] for v in vehicles]),
        "speed": np.array([float(v.speed) for v in vehicles]),
        "heading": np.array([float(v.heading) for v in vehicles]),
        "target_speed": np.array([float(v.target_speed) for v in vehicles]),
    }


def fill_intersection(
    road, table: LaneTable, rng: np.random.Generator, count: int, noise: float, spread: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Put the ego (row 0) and others anywhere on their ways through the intersection.

    `noise`: standard deviation of the lateral position [m]; `spread`: how far from the centre [m].
    Returns routes, stage and drivers. Vehicles know their lane, the lane they steer for and the rest of
    their route, as they do after `follow_road`.
    """
    routes, stage, drivers = [], [], []
    for k in range(count):
        start, turn = int(rng.integers(4)), int(rng.integers(1, 4))
        end = (start + turn) % 4
        way = [(f"o{start}", f"ir{start}", 0), (f"ir{start}", f"il{end}", 0), (f"il{end}", f"o{end}", 0)]
        on = int(rng.integers(3))
        lane = road.network.get_lane(way[on])
        s = {
            0: lane.length - rng.uniform(0, spread),
            1: rng.uniform(0, lane.length),
            2: rng.uniform(0, spread),
        }
        if on < 2 and rng.random() < 0.2:
            s[on] = lane.length - rng.uniform(0, 2.5)  # where the next lane comes into play
        kind = MDPVehicle if k == 0 else IDMVehicle
        vehicle = kind(
            road,
            lane.position(s[on], noise * rng.standard_normal()),
            lane.heading_at(s[on]) + 0.1 * noise * rng.standard_normal(),
            rng.uniform(0, 11),
        )
        vehicle.target_speed = rng.uniform(0, 11)
        vehicle.lane_index = vehicle.target_lane_index = way[on]
        vehicle.lane = lane
        vehicle.route = [way[on]] + [(a, b, None) for a, b, _ in way[on + 1 :]]
        vehicle.follow_road()
        road.vehicles.append(vehicle)
        routes.append(table.route(way))
        stage.append(on)
        drivers.append(randomise(vehicle, rng))
    return np.array(routes), np.array(stage, dtype=np.int64), np.array(drivers)


def path_accelerations(
    geometry: np.ndarray,
    successors: np.ndarray,
    routes: np.ndarray,
    stage: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    speed: np.ndarray,
    heading: np.ndarray,
    target_speed: np.ndarray,
    drivers: np.ndarray,
) -> np.ndarray:
    """`accelerations_along` of vehicles at (x, y), which are looked for on all lanes."""
    lanes = range(len(geometry))
    found = np.array([[local_coordinates(geometry, lane, *at) for lane in lanes] for at in zip(x, y, strict=True)])
    s, lat = np.ascontiguousarray(found.transpose(2, 0, 1))
    return accelerations_along(geometry, successors, routes, stage, s, lat, speed, heading, target_speed, drivers)
