"""highway-env's own draws: the traffic that ``reset(seed=s)`` of highway-env 1.12.1 makes, drawn in its order.

Each function below is the part of ``_make_vehicles`` of its environment that draws, with the same calls of numpy's
generator in the same order, so that a seed means the same episode in both. What highway-env draws during an episode,
the intersection's arrivals, is drawn by `Arrivals` when highway-env does it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace

import numpy as np

from sumo_env.config import Config, ConfigError
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.replica.tables import as_rotated
from sumo_env.tasks import TASKS, roundabout, u_turn
from sumo_env.tasks.base import Task
from sumo_env.tasks.intersection import INITIAL_SPAWN_PROBABILITY
from sumo_env.tasks.two_way import ONCOMING, OWN
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.scenario import EGO, Scenario, Spawn, VehicleSpec, fits

Random = np.random.Generator
Centres = Sequence[tuple[float, float]]  # [m]
# Where vehicles are after a warm-up of this time [s] and frequency [Hz].
WarmUp = Callable[[Road, tuple[VehicleSpec, ...], float, int], Centres]

DELTA, DELTA_RANGE = 4.0, (3.5, 4.5)  # IDMVehicle: the exponent, and its range in `randomize_behavior`
# highway-env's IDMVehicle, as the intersection changes it there.
DRIVERS = {name: Driver("stock", DELTA, **asdict(task.car_following)) for name, task in TASKS.items()}
DEVIATION = 2.0  # [m] and [m/s] of places and speeds on the roundabout and the u-turn
U_TURN_VEHICLES = 6


def draw(task: Task, config: Config, rng: Random, warm_up: WarmUp) -> Scenario:
    """The traffic of a reset of highway-env; leaves `rng` where highway-env leaves it."""
    road = task.road(config)
    vehicles: Sequence[VehicleSpec]
    spawns: tuple[Spawn, ...] = ()
    if task.name == "intersection":

        def driven(placed: tuple[VehicleSpec, ...]) -> Centres:
            return warm_up(road, placed, task.warm_up, int(config["simulation_frequency"]))

        ego, vehicles, spawns = _intersection(config, road, rng, driven)
    else:
        ego, vehicles = _TASKS[task.name](config, road, rng)
    return Scenario(
        task=task.name,
        seed=0,
        risk=0.0,
        ego=ego,
        vehicles=tuple(vehicles),
        spawns=spawns,
        simulation_frequency=int(config["simulation_frequency"]),
        policy_frequency=int(config["policy_frequency"]),
        warm_up=task.warm_up,
        net=road.name,
        road_arguments=road.arguments,
    )


# -- the tasks ----------------------------------------------------------------------------------------------------


def _highway(config: Config, road: Road, rng: Random) -> tuple[VehicleSpec, list[VehicleSpec]]:
    """``HighwayEnv._create_vehicles`` and ``Vehicle.create_random``."""
    lanes = road.count("0", "1")
    spread = math.exp(-5 / 40 * lanes)

    def lane() -> LaneIndex:
        return "0", "1", int(rng.integers(lanes))

    given = config["initial_lane_id"]
    if given is not None and given not in range(lanes):
        raise ConfigError(f"'initial_lane_id' must be None or a lane below 'lanes_count', not {given!r}")
    offset = config["ego_spacing"] * (12.0 + 25.0) * spread
    start = lane() if given is None else ("0", "1", int(given))
    x = 3.0 * offset + offset * rng.uniform(0.9, 1.1)
    ego = _vehicle(road, EGO, start, x, 25.0)
    vehicles = []
    for k in range(int(config["vehicles_count"])):
        start, speed = lane(), rng.uniform(0.7 * 30.0, 0.8 * 30.0)
        x += 1 / config["vehicles_density"] * (12.0 + speed) * spread * rng.uniform(0.9, 1.1)
        vehicles.append(_vehicle(road, f"v{k}", start, x, speed, delta=_delta(rng)))
    return ego, vehicles


def _two_way(config: Config, road: Road, rng: Random) -> tuple[VehicleSpec, list[VehicleSpec]]:
    """``TwoWayEnv._make_vehicles``."""
    ego = _vehicle(road, EGO, OWN, 30.0, 30.0)
    columns = [(OWN, 70.0 + 40.0 * i, 24.0, 2.0) for i in range(3)]
    columns += [(ONCOMING, 200.0 + 100.0 * i, 20.0, 5.0) for i in range(2)]
    vehicles = []
    for k, (lane, s, speed, deviation) in enumerate(columns):
        s, speed = s + 10.0 * rng.normal(), speed + deviation * rng.normal()
        vehicles.append(_vehicle(road, f"v{k}", lane, s, speed, changes_lanes=False))
    return ego, vehicles


def _roundabout(config: Config, road: Road, rng: Random) -> tuple[VehicleSpec, list[VehicleSpec]]:
    """``RoundaboutEnv._make_vehicles``."""
    incoming = config["incoming_vehicle_destination"]
    if incoming is not None and incoming not in range(len(roundabout.DESTINATIONS)):
        raise ConfigError(f"'incoming_vehicle_destination' must be None, 0, 1 or 2, not {incoming!r}")
    ego = _vehicle(road, EGO, ("ser", "ses", 0), 125.0, 8.0, "nxs")
    vehicles = []
    for k, (lane, s) in enumerate(roundabout.SLOTS):
        s, speed = s + rng.normal() * DEVIATION, 16.0 + rng.normal() * DEVIATION
        goal = incoming if k == 0 and incoming is not None else rng.integers(len(roundabout.DESTINATIONS))
        vehicles.append(
            _vehicle(road, f"v{k}", lane, s, speed, roundabout.DESTINATIONS[goal], delta=_delta(rng))
        )
    return ego, vehicles


def _u_turn(config: Config, road: Road, rng: Random) -> tuple[VehicleSpec, list[VehicleSpec]]:
    """``UTurnEnv._make_vehicles``; only the first driver is drawn."""
    ego = _vehicle(road, EGO, ("a", "b", 0), 0.0, 16.0, "d")
    vehicles = []
    for k, (lane, s, speed) in enumerate(u_turn.SLOTS[:U_TURN_VEHICLES]):
        s, speed = s + rng.normal() * DEVIATION, speed + rng.normal() * DEVIATION
        delta = _delta(rng) if k == 0 else DELTA
        vehicles.append(_vehicle(road, f"v{k}", lane, s, speed, "d", delta=delta))
    return ego, vehicles


def _intersection(
    config: Config, road: Road, rng: Random, warm_up: Callable[[tuple[VehicleSpec, ...]], Centres]
) -> tuple[VehicleSpec, Sequence[VehicleSpec], tuple[Spawn, ...]]:
    """``IntersectionEnv._make_vehicles``: the others, three seconds of traffic, the challenger, and then the ego."""
    count = int(config["initial_vehicle_count"])
    vehicles: list[VehicleSpec] = []
    for k, place in enumerate(np.linspace(0, 80, count)[:-1] if count > 0 else ()):
        there = [(v.x, v.y) for v in vehicles]
        vehicle = _arrival(f"v{k}", road, rng, there, INITIAL_SPAWN_PROBABILITY, float(place))
        if vehicle is not None:
            vehicles.append(vehicle)
    placed = tuple(vehicles)
    centres = warm_up(placed)
    challenger = _arrival("challenger", road, rng, centres, 1.0, 60.0, (0.1, 0.0), straight=True)
    destination = config["destination"] or f"o{rng.integers(1, 4)}"
    if destination not in ("o1", "o2", "o3"):
        raise ConfigError(f"'destination' must be 'o1', 'o2', 'o3' or None, not {destination!r}")
    ego = _vehicle(road, EGO, ("o0", "ir0", 0), 60.0 + 5.0 * rng.normal(1.0), 10.0, destination)
    return ego, placed, () if challenger is None else (Spawn(0, challenger),)


_TASKS = {"highway": _highway, "two-way": _two_way, "roundabout": _roundabout, "u-turn": _u_turn}


# -- arrivals -----------------------------------------------------------------------------------------------------


def arrival(config: Config, road: Road, rng: Random, centres: Centres, step: int) -> Spawn | None:
    """The vehicle that arrives at the intersection after this policy step; `centres` of those that are there [m]."""
    vehicle = _arrival(f"s{step}", road, rng, centres, config["spawn_probability"])
    return None if vehicle is None else Spawn(step, vehicle)


def _arrival(
    id: str,
    road: Road,
    rng: Random,
    centres: Iterable[tuple[float, float]],
    probability: float,
    longitudinal: float = 0.0,
    deviations: tuple[float, float] = (1.0, 1.0),
    straight: bool = False,
) -> VehicleSpec | None:
    """``IntersectionEnv._spawn_vehicle``; its exponent is drawn only if there is room for it."""
    if rng.uniform() > probability:
        return None
    start, goal = rng.choice(4, size=2, replace=False).tolist()
    if straight:
        goal = (start + 2) % 4
    s = longitudinal + 5.0 + rng.normal() * deviations[0]
    speed = 8.0 + rng.normal() * deviations[1]
    vehicle = _vehicle(road, id, (f"o{start}", f"ir{start}", 0), s, speed, f"o{goal}")
    if not fits(vehicle, centres):
        return None
    return vehicle._replace(driver=_driver(road, _delta(rng)))


# -- vehicles -----------------------------------------------------------------------------------------------------


def _delta(rng: Random) -> float:
    """``IDMVehicle.randomize_behavior``."""
    return float(rng.uniform(*DELTA_RANGE))


def _driver(road: Road, delta: float) -> Driver:
    return replace(DRIVERS[road.name], delta=delta)


def _vehicle(
    road: Road,
    id: str,
    lane: LaneIndex,
    s: float,
    speed: float,
    destination: str | None = None,
    delta: float = DELTA,
    changes_lanes: bool = True,
) -> VehicleSpec:
    """``Vehicle.make_on_lane``: in the middle of a lane or, beyond its ends, on the closest lane."""
    curve = as_rotated(road)[lane]
    (x, y), heading = curve.position(float(s), 0.0), curve.heading_at(float(s))
    lane = road.closest_lane(x, y, heading)
    return VehicleSpec(
        id=id,
        lane=lane,
        s=road.lane(lane).local_coordinates(x, y)[0],
        x=x,
        y=y,
        heading=heading,
        speed=float(speed),
        target_speed=float(speed),
        destination=destination,
        driver=_driver(road, delta),
        changes_lanes=changes_lanes,
        timer=((x + y) * math.pi) % 1.0,  # IDMVehicle.timer
    )
