"""Intersection: turn left across traffic that has right of way (highway-env ``intersection-v2``)."""

import math

import numpy as np

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks.roads import Road, intersection
from sumo_env.streams import Random, stream
from sumo_env.tasks.base import Drivers, EgoState, Specs, Task, ego_driver, make_on_lane, speed_term, weighted
from sumo_env.traffic.drivers import Calibration, CarFollowing, RiskRanges
from sumo_env.traffic.measured import FROM_REST, STOP_SIGN, MeasuredPool
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import Spawn, VehicleSpec, car_id, fits

ARRIVAL = 25.0  # [m] on an exit
INITIAL_SPAWN_PROBABILITY = 0.6  # hard-coded in highway-env, independent of the config's spawn_probability


class Intersection(Task):
    """Left turn at a crossing without traffic lights."""

    name = "intersection"
    reference, versions = "IntersectionEnv", (0, 1, 2)
    ego_road = ("o0", "ir0")
    defaults = {
        "observation": {
            "type": "Kinematics",
            "vehicles_count": 15,
            "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h"],
            "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-20, 20], "vy": [-20, 20]},
            "absolute": True,
            "flatten": False,
            "observe_intentions": False,
        },
        "action": {**DISCRETE_META_ACTION, "lateral": False, "target_speeds": [0, 4.5, 9]},
        "duration": 13,  # [s]
        "destination": "o1",
        "initial_vehicle_count": 10,
        "spawn_probability": 0.6,
        "collision_reward": -5,
        "high_speed_reward": 1,
        "arrived_reward": 1,
        "reward_speed_range": [7.0, 9.0],  # [m/s]
        "normalize_reward": False,
        "offroad_terminal": False,
        "screen_width": 600,
        "screen_height": 600,
        "centering_position": [0.5, 0.6],
        "scaling": 5.5 * 1.3,
    }
    levels = {
        f"{count}": {"initial_vehicle_count": count, "spawn_probability": probability}
        for count, probability in zip((10, 15, 20, 25, 30), (0.6, 0.7, 0.8, 0.9, 1.0), strict=True)
    }
    car_following = CarFollowing(accel=6.0, decel=3.0, min_gap=2.0)
    warm_up = 3.0  # highway-env drives three seconds before it places the ego
    calibration = Calibration(lane_changes=False, waits_for_approaching=False, ignores_inside=0.35, tau=1.2)
    measured = MeasuredPool(FROM_REST, STOP_SIGN, crossing=8.4)
    risk_ranges = RiskRanges(tau=(0.2, 1.0), min_gap=(0.1, 1.0), decel=(0.6, 1.0), not_giving_way=0.8)
    risk_rates = RiskRates(surge=0.1, surge_way=20.0)
    target_speeds = (0.0, 4.5, 9.0)
    shares_reward = True

    def road(self, config: Config) -> Road:
        return intersection()

    def ego(self, config: Config, road: Road, rng: Random) -> VehicleSpec:
        return self.car(0, config, road, rng)

    def car(self, number: int, config: Config, road: Road, rng: Random) -> VehicleSpec:
        """A learning car at the start: each on the next arm, clockwise."""
        destination = config["destination"] or f"o{rng.integers(1, 4)}"
        if destination not in ("o1", "o2", "o3"):
            raise ConfigError(f"'destination' must be 'o1', 'o2', 'o3' or None, not {destination!r}")
        s, arm = 60.0 + 5.0 * float(rng.normal(1.0)), number % 4
        lane, driver = (f"o{arm}", f"ir{arm}", 0), ego_driver(self)
        return make_on_lane(
            road, car_id(number), lane, s, 10.0, driver, destination=destination, target_speed=9.0
        )

    def with_cars(
        self, config: Config, road: Road, ego: VehicleSpec, vehicles: Specs, count: int, rng: Random
    ) -> Specs:
        if count > 4:
            raise ConfigError(f"'controlled_vehicles' is at most 4, one on each arm, not {count}")
        cars = [self.car(number, config, road, rng) for number in range(1, count)]
        # who comes from its destination takes the first exit of the way back there that highway-env's car drives
        return [*vehicles, *(spec._replace(destination=_exit(road, spec)) for spec in cars)]

    def vehicles(self, config: Config, road: Road, ego: VehicleSpec, rng: Random, drivers: Drivers) -> Specs:
        count = int(config["initial_vehicle_count"])
        vehicles: list[VehicleSpec] = []
        for k, place in enumerate(np.linspace(0.0, 80.0, count)[:-1] if count > 0 else ()):
            attempt = _attempt(f"v{k}", road, rng, drivers, INITIAL_SPAWN_PROBABILITY, float(place))
            if attempt is not None and fits(attempt, [(v.x, v.y) for v in vehicles]):
                vehicles.append(attempt)
        return vehicles

    def spawns(self, config: Config, road: Road, seed: int, drivers: Drivers) -> list[Spawn]:
        rng = stream(seed, "spawns")
        steps = math.ceil(config["duration"] * config["policy_frequency"])
        challenger = _attempt("challenger", road, rng, drivers, 1.0, 60.0, straight=True)
        assert challenger is not None  # its probability is 1
        attempts = (
            (step, _attempt(f"s{step}", road, rng, drivers, config["spawn_probability"], 0.0))
            for step in range(1, steps + 1)
        )
        later = [Spawn(step, vehicle) for step, vehicle in attempts if vehicle is not None]
        return [Spawn(0, challenger), *later]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "collision_reward": float(ego.crashed),
            "high_speed_reward": speed_term(ego.speed, config["reward_speed_range"]),
            "arrived_reward": float(self.arrived(ego)),
            "on_road_reward": float(ego.on_road),
        }

    def reward(self, rewards: dict[str, float], config: Config) -> float:
        # Arrival replaces everything else, a crash included.
        reward = config["arrived_reward"] if rewards["arrived_reward"] else weighted(rewards, config)
        return self.normalized(float(reward * rewards["on_road_reward"]), config)

    def reward_limits(self, config: Config) -> tuple[float, float]:
        return config["collision_reward"], config["arrived_reward"]

    def arrived(self, ego: EgoState) -> bool:
        return ego.lane[0].startswith("il") and ego.lane[1].startswith("o") and ego.s >= ARRIVAL


def _exit(road: Road, car: VehicleSpec) -> str:
    """The first arm on a car's way."""
    assert car.destination is not None
    return road.route(car.lane[1], car.destination)[2]


def _attempt(
    id: str,
    road: Road,
    rng: Random,
    drivers: Drivers,
    probability: float,
    longitudinal: float,
    straight: bool = False,
) -> VehicleSpec | None:
    """One attempt of highway-env's ``_spawn_vehicle``; draws the same numbers whether it succeeds or not."""
    success = rng.random() <= probability
    start, goal = rng.choice(4, size=2, replace=False).tolist()
    place, speed = rng.standard_normal(), rng.standard_normal()
    driver = drivers.next()
    if straight:
        goal, place, speed = (start + 2) % 4, 0.1 * place, 0.0
    if not success:
        return None
    lane, s = (f"o{start}", f"ir{start}", 0), longitudinal + 5.0 + place
    return make_on_lane(road, id, lane, s, 8.0 + speed, driver, destination=f"o{goal}")
