"""Exit: cross six lanes to the right in time to leave a highway (highway-env ``exit-v0``)."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks.roads import LaneIndex, Road, exit_road
from sumo_env.scene import PERCEPTION_DISTANCE
from sumo_env.streams import Random
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, make_on_lane, speed_term
from sumo_env.tasks.highway import gap
from sumo_env.traffic.drivers import Calibration
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, VehicleSpec

START = ("0", "1")
BESIDE, EXIT = ("1", "2"), ("2", "exit", 0)  # the road whose right lane leads to the exit, and the exit
AHEAD = "3"  # where all others drive to
SPEED = 25.0  # [m/s] of the ego


class Exit(Task):
    """Six lanes, each slower than the one to its left; the exit is on the right, and the ego starts on the left."""

    name = "exit"
    reference, versions = "ExitEnv", (0, 1)
    ego_road = START
    defaults = {
        "observation": {
            "type": "ExitObservation",
            "vehicles_count": 15,
            "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h"],
            "clip": False,
        },
        "action": {**DISCRETE_META_ACTION, "target_speeds": [18, 24, 30]},
        "simulation_frequency": 5,  # [Hz]
        "scaling": 5,
        "lanes_count": 6,
        "vehicles_count": 20,
        "duration": 18,  # [s]
        "ego_spacing": 2,
        "vehicles_density": 1.5,
        "collision_reward": 0,
        "goal_reward": 1,
        "high_speed_reward": 0.1,
        "right_lane_reward": 0,
        "reward_speed_range": [20, 30],  # [m/s]
        "normalize_reward": True,
        # accepted as in highway-env, where these are not read either
        "initial_lane_id": None,
        "lane_change_reward": 0,
        "offroad_terminal": False,
    }
    levels = {"20": {"vehicles_count": 20}}
    calibration = Calibration(lane_changes=False)
    risk_rates = RiskRates(cut_in=0.1, brake=0.1)
    fixed_delta = True
    target_speeds = (18.0, 24.0, 30.0)

    def road(self, config: Config) -> Road:
        if config["lanes_count"] < 2:
            raise ConfigError(
                "'lanes_count' of the exit is at least 2: on the left lane there is the ego alone"
            )
        return exit_road(lanes_count=int(config["lanes_count"]))

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        spacing = gap(SPEED, config["ego_spacing"], road.count(*START))
        s = 3.0 * spacing + spacing * rng.uniform(0.9, 1.1)
        return make_on_lane(road, EGO, (*START, 0), s, SPEED, ego_driver(self))

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        # no vehicle further ahead is ever seen
        reach = ego.s + max(self.target_speeds) * config["duration"] + 2 * PERCEPTION_DISTANCE
        how: dict[str, Any] = {"destination": AHEAD, "changes_lanes": False}
        return [
            make_on_lane(road, f"v{k}", lane, s, speed, drivers.next(), concerns_ego=s <= reach, **how)
            for k, (lane, s, speed) in enumerate(places(config, road, ego.s, rng))
        ]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "collision_reward": float(ego.crashed),
            "goal_reward": float(self.arrived(ego)),
            "high_speed_reward": speed_term(ego.speed, config["reward_speed_range"]),
            "right_lane_reward": float(ego.target_lane[2]),
        }

    def reward(self, rewards: dict[str, float], config: Config) -> float:
        reward = super().reward(rewards, config)
        return min(max(reward, 0.0), 1.0) if config["normalize_reward"] else reward

    def reward_limits(self, config: Config) -> tuple[float, float]:
        return config["collision_reward"], config["goal_reward"]

    def arrived(self, ego: EgoState) -> bool:
        """Whether the ego steers for the exit, or the lane that leads there; the episode goes on."""
        *road, lane = ego.target_lane
        return ego.target_lane == EXIT or (tuple(road) == BESIDE and lane == ego.lanes_abreast - 1)

    def terminated(self, ego: EgoState, config: Config) -> bool:
        return ego.crashed


def places(config: Config, road: Road, s: float, rng: Random) -> Iterator[tuple[LaneIndex, float, float]]:
    """Lanes, s [m] and speeds [m/s] of the others, as ``ExitEnv._create_vehicles`` draws them; s: of the ego."""
    numbers = np.arange(road.count(*START))
    for _ in range(int(config["vehicles_count"])):
        lane = (*START, int(rng.choice(numbers, p=numbers / numbers.sum())))
        speed = road.lane(lane).speed_limit
        s += gap(speed, 1 / config["vehicles_density"], len(numbers)) * rng.uniform(0.9, 1.1)
        yield lane, s, speed
