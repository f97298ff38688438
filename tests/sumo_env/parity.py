"""States of highway-env at random, as `sumo_env` sees them: a scene and the ego's state."""

from typing import Any

import numpy as np
from highway_env.vehicle.controller import ControlledVehicle

from experiments.backends.highway_env import ENVIRONMENTS, ScenarioEnv
from sumo_env.tasks.base import EgoState

SMALL: dict[str, dict[str, Any]] = {"highway": {"vehicles_count": 12, "vehicles_density": 2, "duration": 12}}


def make(task: str, **config: Any) -> ScenarioEnv:
    return ENVIRONMENTS[task]({**SMALL.get(task, {}), **config})


def stock(task: str) -> Any:
    """highway-env's own environment of a task."""
    return ENVIRONMENTS[task].__mro__[2]


def ego_state(env: ScenarioEnv, action: int | None) -> EgoState:
    """As `DrivingEnv` derives it, on our own road; the lane has to be the one that highway-env found."""
    ego, scene = env.vehicle, env._scene()
    road = env.task.road(env.config)
    x, y, heading = float(scene.x[0]), float(scene.y[0]), float(scene.heading[0])
    index = road.closest_lane(x, y, heading)
    s, lateral = road.lane(index).local_coordinates(x, y)
    start, end, lane = ego.target_lane_index
    return EgoState(
        lane=index,
        s=s,
        lateral=lateral,
        speed=float(scene.speed[0]),
        heading=heading,
        target_lane=(start, end, int(lane)),
        speed_index=int(ego.speed_index),
        speed_count=len(env.target_speeds),
        action=action,
        crashed=bool(ego.crashed),
        on_road=road.lane(index).covers(s, lateral),
        scene=scene,
        lanes_abreast=road.count(start, end),
    )


def scatter(env: ScenarioEnv, rng: np.random.Generator) -> None:
    """Put every vehicle anywhere near the road, in any state; the ego keeps to its route now and then."""
    network = env.road.network
    lanes = list(network.lanes_dict())
    for vehicle in env.road.vehicles:
        index = lanes[int(rng.integers(len(lanes)))]
        lane = network.get_lane(index)
        s = rng.uniform(-5.0, min(lane.length, 400.0) + 5.0)
        vehicle.position = np.array(lane.position(s, rng.normal() * 1.5))
        vehicle.heading = lane.heading_at(s) + rng.normal() * rng.choice([0.05, 1.0])
        vehicle.speed = rng.choice([rng.uniform(-3.0, 35.0), 8.0, 16.0, 20.0])
        vehicle.crashed = bool(rng.random() < 0.1)
        vehicle.on_state_update()
    ego: ControlledVehicle = env.vehicle
    ego.speed_index = int(rng.integers(len(env.target_speeds)))
    ego.target_speed = env.target_speeds[ego.speed_index]
    lane = int(rng.integers(len(network.all_side_lanes(ego.lane_index))))
    ego.target_lane_index = (*ego.lane_index[:2], lane)
