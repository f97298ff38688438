"""Roundabout: merge into a two-lane ring and drive through it (highway-env ``roundabout-v1``)."""

import math

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks.roads import LaneIndex, Road, roundabout
from sumo_env.streams import Random
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, make_on_lane
from sumo_env.traffic.drivers import Calibration, RiskRanges
from sumo_env.traffic.measured import FROM_REST, ROUNDABOUT, MeasuredPool
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, VehicleSpec

DESTINATIONS = ("exr", "sxr", "nxr")
# (lane, s [m]) of highway-env's four vehicles; each with a deviation of 2 m and 2 m/s
SLOTS: tuple[tuple[LaneIndex, float], ...] = (
    (("we", "sx", 1), 5.0),
    (("we", "sx", 0), 20.0),
    (("we", "sx", 0), -20.0),
    (("eer", "ees", 0), 50.0),
)
# Vehicles beyond these are placed anywhere on these (RoundaboutGenericEnv's law).
EXTRA_ROADS = (
    *(("we", "sx"), ("sx", "se"), ("ee", "nx"), ("nx", "ne")),
    *(("eer", "ees"), ("ner", "nes"), ("wer", "wes")),
)
MIN_SPACING = 7.0  # [m] between centres, RoundaboutGenericEnv


class Roundabout(Task):
    """Straight through a ring without right of way."""

    name = "roundabout"
    reference, versions = "RoundaboutEnv", (0, 1)
    ego_road = ("ser", "ses")
    defaults = {
        "observation": {
            "type": "Kinematics",
            "absolute": True,
            "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-15, 15], "vy": [-15, 15]},
        },
        "action": {**DISCRETE_META_ACTION, "target_speeds": [0, 8, 16]},
        "vehicles_count": 4,
        "incoming_vehicle_destination": None,
        "collision_reward": -1,
        "high_speed_reward": 0.2,
        "right_lane_reward": 0,  # accepted as in highway-env, where no such term is computed either
        "lane_change_reward": -0.05,
        "duration": 11,  # [s]
        "normalize_reward": True,
        "screen_width": 600,
        "screen_height": 600,
        "centering_position": [0.5, 0.6],
    }
    levels = {"5": {"vehicles_count": 5}, "10": {"vehicles_count": 10}, "15": {"vehicles_count": 15}}
    # Surges alone empty the ring before a slow ego arrives, so some drivers also brake to a standstill in it.
    calibration = Calibration(lane_changes=False, ignores_approaching=0.85, ignores_inside=0.5)
    measured = MeasuredPool(FROM_REST, ROUNDABOUT, crossing=4.0)
    # Tailgating drivers whom right of way does not stop make up for half of the events (docs/traffic-and-risk.md).
    risk_ranges = RiskRanges(tau=(0.2, 1.0), min_gap=(0.1, 1.0), not_giving_way=1.0)
    risk_rates = RiskRates(
        cut_in=0.1, brake=0.05, brake_decel=8.0, brake_duration=3.0, surge=0.1, surge_way=10.0
    )
    target_speeds = (0.0, 8.0, 16.0)
    start_places = tuple((("ser", "ses", 0), s) for s in (100.0, 75.0, 50.0, 25.0))  # behind the ego

    def road(self, config: Config) -> Road:
        return roundabout()

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        return make_on_lane(road, EGO, ("ser", "ses", 0), 125.0, 8.0, ego_driver(self), destination="nxs")

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        given = incoming(config)
        vehicles: list[VehicleSpec] = []
        for k in range(int(config["vehicles_count"])):
            destination = DESTINATIONS[int(rng.integers(3))]
            if k == 0 and given:
                destination = given
            if k < len(SLOTS):
                lane, s = SLOTS[k]
                s += 2.0 * float(rng.normal())
            else:
                place = _free_place(road, [ego, *vehicles], rng)
                if place is None:
                    break
                lane, s = place
            speed = 16.0 + 2.0 * float(rng.normal())
            vehicles.append(
                make_on_lane(road, f"v{k}", lane, s, speed, drivers.next(), destination=destination)
            )
        return vehicles

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "collision_reward": float(ego.crashed),
            # highway-env divides by the number of its default target speeds, also if the config gives others
            "high_speed_reward": ego.speed_index / 2,
            "lane_change_reward": float(ego.action in (0, 2)),
            "on_road_reward": float(ego.on_road),
        }

    def reward_limits(self, config: Config) -> tuple[float, float]:
        return config["collision_reward"], config["high_speed_reward"]


def incoming(config: Config) -> str | None:
    """The destination of the first vehicle, which enters the ring; None if it is drawn."""
    number = config["incoming_vehicle_destination"]
    if number is not None and number not in range(len(DESTINATIONS)):
        raise ConfigError(f"'incoming_vehicle_destination' must be None, 0, 1 or 2, not {number!r}")
    return None if number is None else DESTINATIONS[number]


def _free_place(road: Road, vehicles: list[VehicleSpec], rng: Random) -> tuple[LaneIndex, float] | None:
    """A place at least `MIN_SPACING` from all vehicles; None where 100 tries found none."""
    for _ in range(100):
        start, end = EXTRA_ROADS[int(rng.integers(len(EXTRA_ROADS)))]
        lane = (start, end, int(rng.integers(road.count(start, end))))
        s = float(rng.uniform(5.0, max(5.0, road.lane(lane).length - 5.0)))
        x, y = road.lane(lane).position(s, 0.0)
        if all(math.hypot(x - other.x, y - other.y) >= MIN_SPACING for other in vehicles):
            return lane, s
    return None
