"""Two-way road: overtake slower cars through the lane of the oncoming traffic (highway-env ``two-way-v0``).

The reward has no crash term, as in highway-env: a crash only ends the episode. Return is not safety here.
"""

import numpy as np

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks.roads import Road, two_way
from sumo_env.streams import Random
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, make_on_lane
from sumo_env.traffic.drivers import Calibration
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, VehicleSpec

OWN, ONCOMING = ("a", "b", 1), ("b", "a", 0)
MIN_SPACING = 6.0  # [m] between centres in a column


class TwoWay(Task):
    """One lane per direction, slower vehicles ahead, and oncoming ones."""

    name = "two-way"
    reference, versions = "TwoWayEnv", (0,)
    ego_road = ("a", "b")
    defaults = {
        "observation": {
            "type": "Kinematics",
            "features_range": {"x": [-200, 200], "y": [-8, 8], "vx": [-80, 80], "vy": [-80, 80]},
        },
        "action": DISCRETE_META_ACTION,
        "vehicles_count": 3,  # in the ego's direction
        "oncoming_vehicles_count": 2,
        "road_length": 800.0,  # [m]
        "duration": 15,  # [s]
        "collision_reward": 0,  # accepted as in highway-env, where no such term is computed either
        "left_lane_constraint": 1,  # likewise
        "left_lane_reward": 0.2,
        "high_speed_reward": 0.8,
    }
    levels = {
        "5+2": {"vehicles_count": 5, "oncoming_vehicles_count": 2, "road_length": 800.0 * 2 / 3},
        "10+4": {"vehicles_count": 10, "oncoming_vehicles_count": 4, "road_length": 800.0 * 2 / 3},
        "15+6": {"vehicles_count": 15, "oncoming_vehicles_count": 6, "road_length": 800.0 * 2 / 3},
    }
    calibration = Calibration(lane_changes=False)
    risk_rates = RiskRates(cut_in=0.01, brake=0.2, brake_decel=5.0, brake_duration=1.5)
    fixed_delta = True
    start_places = ((OWN, 5.0),)  # 25 m behind the ego

    def road(self, config: Config) -> Road:
        return two_way(road_length=float(config["road_length"]))

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        return make_on_lane(road, EGO, OWN, 30.0, 30.0, ego_driver(self))

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        length = float(config["road_length"])
        # highway-env: x = 70 + 40 i, and 300, 200 m from the far end. More vehicles move closer together so
        # that all of them are on the road and ahead of the ego.
        ahead, opposite = int(config["vehicles_count"]), int(config["oncoming_vehicles_count"])
        for count, available in ((ahead, length - 90.0), (opposite, 280.0)):
            if available / max(count - 1, 1) <= MIN_SPACING:
                raise ConfigError(f"{count} vehicles do not fit one behind the other into {available:g} m")
        own = column(rng, ahead, 70.0, 40.0, length - 90.0)
        oncoming = column(rng, opposite, 300.0, -100.0, 280.0)
        vehicles = []
        for s, deviation in zip(own, rng.normal(size=len(own)), strict=True):
            vehicles.append((OWN, s, 24.0 + 2.0 * deviation))
        for s, deviation in zip(oncoming, rng.normal(size=len(oncoming)), strict=True):
            vehicles.append((ONCOMING, s, max(20.0 + 5.0 * deviation, 0.0)))
        return [
            make_on_lane(road, f"v{k}", lane, float(s), float(speed), drivers.next(), changes_lanes=False)
            for k, (lane, s, speed) in enumerate(vehicles)
        ]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "high_speed_reward": ego.speed_index / (ego.speed_count - 1),
            "left_lane_reward": float(1 - ego.target_lane[2]),
        }


def column(rng: Random, count: int, start: float, spacing: float, available: float) -> np.ndarray:
    """Places of a column of vehicles [m]: equal spacing with jitter, redrawn until no two cars overlap."""
    step = min(abs(spacing), available / max(count - 1, 1))
    direction = 1.0 if spacing > 0 else -1.0
    deviation, attempt = 10.0 * step / abs(spacing), 1
    while True:
        places = start + direction * step * np.arange(count) + rng.normal(0.0, 1.0, count) * deviation
        if (np.diff(np.sort(places)) > MIN_SPACING).all():
            return places
        if attempt >= 100:  # in a crowded column, chance alone would not find free places
            deviation *= 0.9
        attempt += 1
