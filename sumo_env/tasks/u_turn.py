"""U-turn: overtake in and around a 180-degree bend (highway-env ``u-turn-v1``, by the paper's author)."""

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks.roads import LaneIndex, Road, u_turn
from sumo_env.streams import Random
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, make_on_lane, speed_term
from sumo_env.traffic.drivers import Calibration, RiskRanges
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, VehicleSpec

# (lane, s [m], speed [m/s]); each with a deviation of 2 m and 2 m/s. The first six are highway-env's, the
# others continue its pattern, so that the paper's levels of 9 and 12 exist.
SLOTS: tuple[tuple[LaneIndex, float, float], ...] = (
    (("a", "b", 0), 25.0, 13.5),
    (("a", "b", 1), 56.0, 14.5),
    (("b", "c", 1), 0.5, 4.5),
    (("b", "c", 0), 17.5, 5.5),
    (("c", "d", 0), 1.0, 3.5),
    (("c", "d", 1), 30.0, 5.5),
    (("a", "b", 0), 62.0, 13.5),
    (("b", "c", 1), 38.0, 4.5),
    (("c", "d", 0), 48.0, 4.5),
    (("a", "b", 1), 96.0, 14.5),
    (("b", "c", 0), 44.0, 5.5),
    (("c", "d", 1), 72.0, 5.5),
)


class UTurn(Task):
    """Two lanes around a half circle, with slow cars in the bend."""

    name = "u-turn"
    reference, versions = "UTurnEnv", (0, 1)
    ego_road = ("a", "b")
    defaults = {
        "observation": {
            "type": "Kinematics",
            # highway-env's default ranges saturate here (y of 48 m in a range of 8 m), hence explicit ones
            "features_range": {"x": [-160, 160], "y": [-50, 50], "vx": [-24, 24], "vy": [-24, 24]},
        },
        "action": {**DISCRETE_META_ACTION, "target_speeds": [8, 16, 24]},
        "vehicles_count": 6,
        "duration": 10,  # [s]
        "collision_reward": -1.0,
        "left_lane_reward": 0.1,
        "high_speed_reward": 0.4,
        "reward_speed_range": [8, 24],  # [m/s]
        "normalize_reward": True,
        "offroad_terminal": False,  # accepted as in highway-env, where it is not read either
        "screen_width": 790,  # highway-env: 789 x 289, odd sizes that few players show as a film
        "screen_height": 290,
    }
    levels = {str(count): {"vehicles_count": count} for count in (3, 6, 9, 12)}
    calibration = Calibration(lane_changes=False)
    risk_ranges = RiskRanges(tau=(0.2, 1.0), min_gap=(0.1, 1.0), decel=(0.5, 1.0))
    risk_rates = RiskRates(cut_in=0.2, brake=0.1, brake_duration=2.0)
    fixed_delta = True
    target_speeds = (8.0, 16.0, 24.0)
    start_places = ((("a", "b", 1), 0.0), (("a", "b", 1), 25.0))  # beside the ego, and ahead of it

    def road(self, config: Config) -> Road:
        return u_turn()

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        return make_on_lane(road, EGO, ("a", "b", 0), 0.0, 16.0, ego_driver(self), destination="d")

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        count = int(config["vehicles_count"])
        if count > len(SLOTS):
            raise ConfigError(f"'vehicles_count' of the u-turn is at most {len(SLOTS)}, not {count}")
        deviations = (rng.normal(size=(len(SLOTS), 2)) * 2.0).tolist()
        vehicles = []
        for k, (lane, s, speed) in enumerate(SLOTS[:count]):
            s, speed = s + deviations[k][0], max(speed + deviations[k][1], 0.0)
            # highway-env calls randomize_behavior on the first vehicle only
            driver = drivers.next(fixed_delta=k > 0)
            vehicles.append(make_on_lane(road, f"v{k}", lane, s, speed, driver, destination="d"))
        return vehicles

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "collision_reward": float(ego.crashed),
            # highway-env's name; lane 1, the one it pays for, is the outer (right) lane
            "left_lane_reward": float(ego.lane[2]),
            "high_speed_reward": speed_term(ego.speed, config["reward_speed_range"]),
            "on_road_reward": float(ego.on_road),
        }

    def reward_limits(self, config: Config) -> tuple[float, float]:
        return config["collision_reward"], config["high_speed_reward"] + config["left_lane_reward"]

    def terminated(self, ego: EgoState, config: Config) -> bool:
        return ego.crashed
