"""Intersection: turn left across traffic that has right of way (highway-env ``intersection-v2``)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.drivers import CarFollowing, RiskRates
from sumo_env.models.idm import NEAR, driver_rows
from sumo_env.models.lane_grid import lane_grid
from sumo_env.models.lane_table import Floats, Integers, compiled_lanes
from sumo_env.models.warm_up import warm_up
from sumo_env.networks.lanes import VEHICLE_LENGTH
from sumo_env.networks.roads import LaneIndex, Road, intersection
from sumo_env.scenario import EGO, Spawn, VehicleSpec
from sumo_env.streams import stream
from sumo_env.tasks.base import Drivers, EgoState, Task, ego_driver, lmap, make_on_lane, speed_term, weighted

MIN_SPACING = 15.0  # [m] between centres when a vehicle is added
WARM_UP = 3.0  # [s] of traffic before the ego arrives
WARM_UP_FREQUENCY = 15  # [Hz]
REGULATION_INTERVAL = 7  # steps of the warm-up between two applications of the give-way rule
INITIAL_SPAWN_PROBABILITY = 0.6  # hard-coded in highway-env, whatever the config's spawn_probability


class Intersection(Task):
    """Left turn at an unsignalised crossing; the ego is never given way on purpose."""

    name = "intersection"
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
    risk_rates = RiskRates(surge=0.2, surge_way=20.0)
    target_speeds = (0.0, 4.5, 9.0)

    def road(self, config: Config) -> Road:
        return intersection()

    def ego(self, config: Config, road: Road, rng: np.random.Generator) -> VehicleSpec:
        destination = config["destination"]
        if destination not in ("o1", "o2", "o3"):
            raise ConfigError(f"'destination' must be 'o1', 'o2' or 'o3', not {destination!r}")
        s = 60.0 + 5.0 * float(rng.normal(1.0))
        return make_on_lane(
            road,
            EGO,
            ("o0", "ir0", 0),
            s,
            10.0,
            ego_driver(self),
            destination=destination,
            target_speed=9.0,
        )

    def vehicles(
        self, config: Config, road: Road, ego: VehicleSpec, rng: np.random.Generator, drivers: Drivers
    ) -> list[VehicleSpec]:
        count = int(config["initial_vehicle_count"])
        vehicles: list[VehicleSpec] = []
        for k, place in enumerate(np.linspace(0.0, 80.0, count)[:-1] if count > 0 else ()):
            attempt = _attempt(f"v{k}", road, rng, drivers, INITIAL_SPAWN_PROBABILITY, float(place))
            if attempt is not None and fits(attempt, [(v.x, v.y) for v in vehicles]):
                vehicles.append(attempt)
        vehicles = _warm_up(road, vehicles)
        challenger = _attempt("challenger", road, rng, drivers, 1.0, 60.0, straight=True)
        if challenger is not None and fits(challenger, [(v.x, v.y) for v in vehicles]):
            vehicles.append(challenger)
        return [v for v in vehicles if math.hypot(v.x - ego.x, v.y - ego.y) >= 20.0]

    def spawns(self, config: Config, road: Road, seed: int, drivers: Drivers) -> list[Spawn]:
        rng = stream(seed, "spawns")
        steps = math.ceil(config["duration"] * config["policy_frequency"])
        attempts = (
            (step, _attempt(f"s{step}", road, rng, drivers, config["spawn_probability"], 0.0))
            for step in range(1, steps + 1)
        )
        return [Spawn(step, vehicle) for step, vehicle in attempts if vehicle is not None]

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        return {
            "collision_reward": float(ego.crashed),
            "high_speed_reward": speed_term(ego.speed, config),
            "arrived_reward": float(self.arrived(ego)),
            "on_road_reward": float(ego.on_road),
        }

    def reward(self, rewards: dict[str, float], config: Config) -> float:
        # Arrival replaces everything else, a crash included.
        reward = config["arrived_reward"] if rewards["arrived_reward"] else weighted(rewards, config)
        reward *= rewards["on_road_reward"]
        if config["normalize_reward"]:
            reward = lmap(reward, (config["collision_reward"], config["arrived_reward"]), (0.0, 1.0))
        return float(reward)

    def arrived(self, ego: EgoState) -> bool:
        return ego.lane[0].startswith("il") and ego.lane[1].startswith("o") and ego.s >= 25.0


def path(start: LaneIndex, destination: str) -> list[LaneIndex]:
    """Lanes of the way from an arm's entry lane to the exit node `destination`."""
    entry, out = start[1], f"il{destination[1:]}"
    return [start, (entry, out, 0), (out, destination, 0)]


def fits(vehicle: VehicleSpec, centres: list[tuple[float, float]]) -> bool:
    """highway-env's spawn rule: no vehicle within 15 m."""
    return all(math.hypot(vehicle.x - x, vehicle.y - y) >= MIN_SPACING for x, y in centres)


def _attempt(
    id: str,
    road: Road,
    rng: np.random.Generator,
    drivers: Drivers,
    probability: float,
    longitudinal: float,
    straight: bool = False,
) -> VehicleSpec | None:
    """One try of highway-env's ``_spawn_vehicle``; draws the same numbers whether it succeeds or not."""
    success = rng.random() <= probability
    start, goal = rng.choice(4, size=2, replace=False).tolist()
    place, speed = rng.standard_normal(), rng.standard_normal()
    driver = drivers.next()
    if straight:
        goal, place, speed = (start + 2) % 4, 0.1 * place, 0.0
    if not success:
        return None
    return make_on_lane(
        road,
        id,
        (f"o{start}", f"ir{start}", 0),
        longitudinal + 5.0 + place,
        8.0 + speed,
        driver,
        destination=f"o{goal}",
    )


@lru_cache(maxsize=2)
def _grid(road: Road) -> tuple[Floats, Integers]:
    """`lane_grid` of the lanes on which vehicles are leaders."""
    return lane_grid(compiled_lanes(road).geometry, VEHICLE_LENGTH, NEAR)


@lru_cache(maxsize=64)
def _path(road: Road, lane: LaneIndex, destination: str) -> tuple[list[LaneIndex], Integers]:
    """`path`, and the numbers of its lanes."""
    lanes = path(lane, destination)
    return lanes, compiled_lanes(road).route(lanes)


def _warm_up(road: Road, vehicles: list[VehicleSpec]) -> list[VehicleSpec]:
    """Let the first vehicles drive for 3 s by highway-env's rules, on paths, without any simulator.

    So both simulators start from the same traffic. Contacts are not looked for: they are rare (docs/decisions.md).
    """
    if not vehicles:
        return []
    table = compiled_lanes(road)
    n = len(vehicles)
    paths, numbers = zip(*[_path(road, v.lane, v.destination or "") for v in vehicles], strict=True)
    routes = np.array(numbers)
    rows = driver_rows(v.driver for v in vehicles)
    exempt = np.array([not v.driver.gives_way for v in vehicles])
    stage = np.zeros(n, np.int64)
    s = np.array([v.s for v in vehicles])
    x, y, heading, speed, target_speed = (
        np.array([getattr(v, name) for v in vehicles])
        for name in ("x", "y", "heading", "speed", "target_speed")
    )
    yielding = np.zeros(n, np.bool_)
    steps = int(WARM_UP * WARM_UP_FREQUENCY)
    warm_up(
        table.geometry, table.successors, routes, stage, s, x, y, heading, speed, target_speed, rows,
        *_grid(road), exempt, yielding, steps, REGULATION_INTERVAL, 1.0 / WARM_UP_FREQUENCY,
    )  # fmt: skip
    return [
        VehicleSpec(
            v.id, lanes[stage[i]], s.item(i), x.item(i), y.item(i), heading.item(i), speed.item(i),
            target_speed.item(i), v.destination, v.driver, v.changes_lanes, v.timer, yielding.item(i),
        )
        for i, (v, lanes) in enumerate(zip(vehicles, paths, strict=True))
        # those that have left, as highway-env removes them after the first step
        if not (stage[i] == 2 and s[i] >= road.lane(lanes[2]).length - 20.0)
    ]  # fmt: skip
