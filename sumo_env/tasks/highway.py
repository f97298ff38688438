"""Multi-lane highway: drive fast, keep right, avoid the slower traffic ahead (highway-env ``highway-v0``)."""

import math
from typing import Any

import numpy as np

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks.roads import LaneIndex, Road, highway
from sumo_env.scene import MAX_SPEED, PERCEPTION_DISTANCE
from sumo_env.streams import Random
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, make_on_lane, speed_term
from sumo_env.traffic.drivers import Calibration
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, VehicleSpec, car_id

# ``HighwayEnvFast.default_config``, of highway-fast-v0
FAST: Config = {
    "simulation_frequency": 5,  # [Hz]
    "lanes_count": 3,
    "vehicles_count": 20,
    "duration": 30,  # [s]
    "ego_spacing": 1.5,
}


class Highway(Task):
    """Four lanes, all traffic ahead of the ego and slower than it."""

    name = "highway"
    reference, versions = "HighwayEnv", (0,)
    ego_road = ("0", "1")
    defaults = {
        "observation": {"type": "Kinematics"},
        "action": DISCRETE_META_ACTION,
        "lanes_count": 4,
        "vehicles_count": 50,
        "initial_lane_id": None,
        "duration": 40,  # [s]
        "ego_spacing": 2,
        "vehicles_density": 1,
        "collision_reward": -1,
        "right_lane_reward": 0.1,
        "high_speed_reward": 0.4,
        "lane_change_reward": 0,  # accepted as in highway-env, where no such term is computed either
        "reward_speed_range": [20, 30],  # [m/s]
        "normalize_reward": True,
        "offroad_terminal": False,
    }
    levels = {
        "50": {"vehicles_count": 50, "vehicles_density": 1.0, "duration": 20},
        "100": {"vehicles_count": 100, "vehicles_density": 1.5, "duration": 20},
        "150": {"vehicles_count": 150, "vehicles_density": 2.0, "duration": 20},
    }
    calibration = Calibration(speed_gain=100.0, speed_gain_lookahead=35.0, assertive=0.9)
    risk_rates = RiskRates(cut_in=0.035, brake=0.02, brake_decel=3.0)

    def __init__(self, changed: Config | None = None) -> None:
        """The task, with some defaults changed."""
        self.defaults = {**self.defaults, **(changed or {})}

    def road(self, config: Config) -> Road:
        return highway(lanes_count=int(config["lanes_count"]))

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        lane = first_lane(config, rng)
        s = gap(25.0, config["ego_spacing"], config["lanes_count"]) * (3.0 + rng.uniform(0.9, 1.1))
        return make_on_lane(road, EGO, lane, s, 25.0, ego_driver(self))

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        # Each vehicle is placed ahead of all earlier ones, in a random lane (Vehicle.create_random).
        count = int(config["vehicles_count"])
        lanes = rng.integers(config["lanes_count"], size=count)
        speeds = rng.uniform(21.0, 24.0, size=count)  # 0.7 to 0.8 of the speed limit
        jitter = rng.uniform(0.9, 1.1, size=count)
        gaps = gap(speeds, 1.0 / config["vehicles_density"], config["lanes_count"]) * jitter
        places = np.cumsum(np.append(ego.s, gaps))[1:]
        reach = ego.s + self._reach(config)
        vehicles = zip(lanes.tolist(), places.tolist(), speeds.tolist(), strict=True)
        return [
            make_on_lane(road, f"v{k}", ("0", "1", lane), s, speed, drivers.next(), concerns_ego=s <= reach)
            for k, (lane, s, speed) in enumerate(vehicles)
        ]

    def _reach(self, config: Config) -> float:
        """How far ahead of a learning car vehicles concern it [m]."""
        # Even at full speed the ego gets no closer than 400 m to a crashed vehicle further ahead. Leaving such vehicles
        # out changed what the ego sees by less than 2e-5 in 80 episodes; at 200 m, where LC2013 looks further ahead
        # than the ego sees, by more than 1e-4 in every fifth (docs/developers/decisions.md).
        action = config["action"]
        fastest = max(action.get("target_speeds") or self.target_speeds)
        if action["type"] != "DiscreteMetaAction" or action.get("longitudinal") == "sumo":
            fastest = max(fastest, *(action.get("speed_range") or (MAX_SPEED,)))
        return float(fastest * config["duration"] + 2 * PERCEPTION_DISTANCE)

    def with_cars(
        self, config: Config, road: Road, ego: VehicleSpec, vehicles: Specs, count: int, rng: Random
    ) -> Specs:
        # ``HighwayEnv._create_vehicles``: ahead of each learning car an even share of the others, then the next one
        placed, last, shift, done = [], ego, 0.0, 0
        spacing = gap(25.0, config["ego_spacing"], config["lanes_count"])
        for number, share in enumerate(map(len, np.array_split(range(len(vehicles)), count))):
            if number:
                shift += spacing * rng.uniform(0.9, 1.1)
                s = (vehicles[done - 1] if done else ego).s + shift
                last = make_on_lane(road, car_id(number), first_lane(config, rng), s, 25.0, ego.driver)
                placed.append(last)
            placed += [_moved(road, spec, shift) for spec in vehicles[done : done + share]]
            done += share
        reach = last.s + self._reach(config)
        return [spec._replace(concerns_ego=spec.s <= reach) for spec in placed]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        forward = ego.speed * math.cos(ego.heading)
        return {
            "collision_reward": float(ego.crashed),
            "right_lane_reward": ego.target_lane[2] / max(config["lanes_count"] - 1, 1),
            "high_speed_reward": speed_term(forward, config["reward_speed_range"]),
            "on_road_reward": float(ego.on_road),
        }

    def reward_limits(self, config: Config) -> tuple[float, float]:
        return config["collision_reward"], config["high_speed_reward"] + config["right_lane_reward"]


def first_lane(config: Config, rng: Random) -> LaneIndex:
    """The lane in which the ego starts."""
    lane = config["initial_lane_id"]
    if lane is not None and lane not in range(int(config["lanes_count"])):
        raise ConfigError(f"'initial_lane_id' must be None or a lane below 'lanes_count', not {lane!r}")
    return "0", "1", int(rng.integers(config["lanes_count"])) if lane is None else int(lane)


def _moved(road: Road, spec: VehicleSpec, by: float) -> VehicleSpec:
    """A vehicle that starts further ahead [m]."""
    return make_on_lane(road, spec.id, spec.lane, spec.s + by, spec.speed, spec.driver) if by else spec


def gap(speed: Any, spacing: float, lanes: int) -> Any:
    """``Vehicle.create_random``: mean distance to the vehicle behind [m] by speed [m/s]; it shrinks with the lanes."""
    return spacing * (12.0 + speed) * math.exp(-5.0 / 40.0 * lanes)
