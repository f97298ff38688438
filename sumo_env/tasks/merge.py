"""Merge: make room for a car that comes from a ramp (highway-env ``merge-v0``)."""

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.contacts.rectangles import state_of
from sumo_env.networks.roads import LaneIndex, Road, merge
from sumo_env.streams import Random
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, lmap, make_on_lane
from sumo_env.traffic.drivers import Calibration
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, VehicleSpec

SLOTS = ((90.0, 29.0), (70.0, 31.0), (5.0, 31.5))  # s [m], speed [m/s] of the others on the two lanes
S_DEVIATION, SPEED_DEVIATION = 5.0, 1.0  # [m], [m/s]
MERGING = "merging"  # the car on the ramp
RAMP, RAMP_END = ("j", "k", 0), ("b", "c", 2)
WANTED = 30.0  # [m/s] that it would like to drive; its lanes' limit is 20 m/s
PASSED = 60.0  # [m] beyond the third lane, where the episode ends


class Merge(Task):
    """Two lanes with little traffic, and a ramp whose last 80 m are a third lane that ends at an obstacle."""

    name = "merge"
    reference, versions = "MergeEnv", (0, 1)
    ego_road = ("a", "b")
    defaults = {
        "observation": {"type": "Kinematics"},
        "action": DISCRETE_META_ACTION,
        "vehicles_count": 3,  # on the two lanes
        "duration": 20,  # [s]; highway-env has no time limit: at 20 m/s the ego has passed after 17 s
        "collision_reward": -1,
        "right_lane_reward": 0.1,
        "high_speed_reward": 0.2,
        "reward_speed_range": [20, 30],  # [m/s]
        "merging_speed_reward": -0.5,
        "lane_change_reward": -0.05,
    }
    levels = {"3": {"vehicles_count": 3}}
    # With SUMO's strategic changes the car on the ramp would always get in; highway-env's does in every fourth episode,
    # because below 1 m/s it changes no lane (docs/environments/merge.md). The first three are the highway's.
    calibration = Calibration(
        speed_gain=100.0, speed_gain_lookahead=35.0, assertive=0.9, strategic=-1.0, sideways=0.3
    )
    risk_rates = RiskRates(cut_in=0.1, brake=0.1)
    fixed_delta = True

    def road(self, config: Config) -> Road:
        return merge()

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        return make_on_lane(road, EGO, ("a", "b", 1), 30.0, 30.0, ego_driver(self))

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        count = int(config["vehicles_count"])
        if count > len(SLOTS):
            raise ConfigError(f"'vehicles_count' of the merge is at most {len(SLOTS)}, not {count}")
        vehicles = [
            make_on_lane(road, f"v{k}", *place, drivers.next()) for k, place in enumerate(places(rng)[:count])
        ]
        car = make_on_lane(road, MERGING, RAMP, 110.0, 20.0, drivers.next(), target_speed=WANTED)
        return [*vehicles, car]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "collision_reward": float(ego.crashed),
            "right_lane_reward": float(ego.lane[2]),
            "high_speed_reward": lmap(ego.speed, config["reward_speed_range"], (0.0, 1.0)),
            "lane_change_reward": float(ego.action in (0, 2)),
            "merging_speed_reward": _held_up(ego),
        }

    def reward_limits(self, config: Config) -> tuple[float, float]:
        worst = config["collision_reward"] + config["merging_speed_reward"]
        return worst, config["high_speed_reward"] + config["right_lane_reward"]

    def arrived(self, ego: EgoState) -> bool:
        return ego.lane[0] == "c" and ego.s > PASSED


def places(rng: Random) -> list[tuple[LaneIndex, float, float]]:
    """Lanes, s [m] and speeds [m/s] of the others on the two lanes, as ``MergeEnv._make_vehicles`` draws them."""
    drawn = []
    for s, speed in SLOTS:
        lane = ("a", "b", int(rng.integers(2)))
        s += float(rng.uniform(-S_DEVIATION, S_DEVIATION))
        speed += float(rng.uniform(-SPEED_DEVIATION, SPEED_DEVIATION))
        drawn.append((lane, s, speed))
    return drawn


def _held_up(ego: EgoState) -> float:
    """By what share of its wanted speed the car in the third lane is too slow; nobody else can be there."""
    if MERGING not in ego.scene.ids:
        return 0.0
    row = ego.scene.ids.index(MERGING)
    x, y, speed, heading = state_of(ego.scene, row)
    return (WANTED - speed) / WANTED if merge().closest_lane(x, y, heading) == RAMP_END else 0.0
