"""highway-env's own draws: the traffic that ``reset(seed=s)`` of highway-env 1.12.1 makes, drawn in its order.

Each function below is the part of ``_make_vehicles`` of its environment that draws, with the same calls of numpy's
generator in the same order, so that a seed means the same episode in both. What highway-env draws during an episode,
the intersection's arrivals, is drawn by `arrival` when highway-env does it.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from sumo_env.config import Config, ConfigError
from sumo_env.networks.roads import Road
from sumo_env.replica.tables import as_rotated
from sumo_env.streams import Random, stream
from sumo_env.tasks import TASKS, exit, highway, merge, roundabout, u_turn
from sumo_env.tasks.base import Task, cars_count, make_on_lane, obstacles
from sumo_env.tasks.intersection import INITIAL_SPAWN_PROBABILITY, Intersection
from sumo_env.tasks.two_way import ONCOMING, OWN
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.scenario import Scenario, Spawn, VehicleSpec, car_id, fits

Centres = Sequence[tuple[float, float]]  # [m]
Vehicles = tuple[VehicleSpec, ...]
# Where vehicles are after a warm-up of this time [s] and frequency [Hz].
WarmUp = Callable[[Road, Vehicles, float, int], Centres]

DELTA, DELTA_RANGE = 4.0, (3.5, 4.5)  # IDMVehicle: the exponent, and its range in `randomize_behavior`
# highway-env's IDMVehicle, as the intersection changes it there.
DRIVERS = {name: Driver("stock", DELTA, **asdict(task.car_following)) for name, task in TASKS.items()}
DEVIATION = 2.0  # [m] and [m/s] of places and speeds on the roundabout and the u-turn
U_TURN_VEHICLES = 6
INSTEAD = 'make the environment with scenarios="seeded"'


def draw(task: Task, config: Config, rng: Random, warm_up: WarmUp) -> Scenario:
    """The traffic of a reset of highway-env; leaves `rng` where highway-env leaves it."""
    exact = task.road(config)
    road, frequency = as_rotated(exact), int(config["simulation_frequency"])
    spawns: tuple[Spawn, ...] = ()
    cars = cars_count(config)
    if task.name == "highway":
        ego, vehicles = _highway(config, road, rng)
    elif task.name == "exit":
        ego = task.ego(config, road, rng)
        vehicles = _exit(config, road, ego, rng)
    elif task.name == "intersection":
        vehicles = _intersection(config, road, rng)
        centres = warm_up(exact, vehicles, task.warm_up, frequency)
        challenger = _arrival("challenger", road, rng, centres, 1.0, 60.0, (0.1, 0.0), straight=True)
        spawns = () if challenger is None else (Spawn(0, challenger),)
        assert isinstance(task, Intersection)
        ego, *further = [task.car(number, config, road, rng) for number in range(cars)]
        vehicles += tuple(further)
    elif task.name in _OTHERS:
        ego = task.ego(config, road, rng)
        vehicles = _OTHERS[task.name](config, road, rng)
    else:
        raise ConfigError(f"highway-env's draws of the task {task.name!r} are not known here; {INSTEAD}")
    if cars > 1 and task.name not in ("highway", "intersection"):  # whose own draws have them
        vehicles = tuple(task.with_cars(config, road, ego, list(vehicles), cars, rng))
    vehicles += tuple(obstacles(exact))
    return Scenario(
        task=task.name,
        seed=0,
        risk=0.0,
        ego=ego,
        vehicles=vehicles,
        spawns=spawns,
        simulation_frequency=frequency,
        policy_frequency=int(config["policy_frequency"]),
        warm_up=task.warm_up,
        net=road.name,
        road_arguments=road.arguments,
        further=tuple(car_id(number) for number in range(1, cars)),
    )


# -- the tasks ----------------------------------------------------------------------------------------------------


def _highway(config: Config, road: Road, rng: Random) -> tuple[VehicleSpec, Vehicles]:
    """``HighwayEnv._create_vehicles`` and ``Vehicle.create_random``."""
    lanes = road.count("0", "1")
    offset = highway.gap(25.0, config["ego_spacing"], lanes)
    vehicles: list[VehicleSpec] = []
    x, k = 3.0 * offset, 0
    parts = np.array_split(range(int(config["vehicles_count"])), cars_count(config))
    for number, share in enumerate(map(len, parts)):
        start = highway.first_lane(config, rng)
        x += offset * rng.uniform(0.9, 1.1)
        vehicles.append(make_on_lane(road, car_id(number), start, x, 25.0, _driver(road)))
        for _ in range(share):
            start, speed = ("0", "1", int(rng.integers(lanes))), rng.uniform(0.7 * 30.0, 0.8 * 30.0)
            x += highway.gap(speed, 1 / config["vehicles_density"], lanes) * rng.uniform(0.9, 1.1)
            vehicles.append(make_on_lane(road, f"v{k}", start, x, speed, _driver(road, _delta(rng))))
            k += 1
    return vehicles[0], tuple(vehicles[1:])


def _two_way(config: Config, road: Road, rng: Random) -> Vehicles:
    """``TwoWayEnv._make_vehicles``."""
    columns = [(OWN, 70.0 + 40.0 * i, 24.0, 2.0) for i in range(3)]
    columns += [(ONCOMING, 200.0 + 100.0 * i, 20.0, 5.0) for i in range(2)]
    vehicles = []
    for k, (lane, s, speed, deviation) in enumerate(columns):
        s, speed = s + 10.0 * rng.normal(), speed + deviation * rng.normal()
        vehicles.append(make_on_lane(road, f"v{k}", lane, s, speed, _driver(road), changes_lanes=False))
    return tuple(vehicles)


def _roundabout(config: Config, road: Road, rng: Random) -> Vehicles:
    """``RoundaboutEnv._make_vehicles``."""
    incoming = roundabout.incoming(config)
    vehicles = []
    for k, (lane, s) in enumerate(roundabout.SLOTS):
        s, speed = s + rng.normal() * DEVIATION, 16.0 + rng.normal() * DEVIATION
        goal = incoming if k == 0 and incoming else roundabout.DESTINATIONS[rng.integers(3)]
        driver = _driver(road, _delta(rng))
        vehicles.append(make_on_lane(road, f"v{k}", lane, s, speed, driver, destination=goal))
    return tuple(vehicles)


def _u_turn(config: Config, road: Road, rng: Random) -> Vehicles:
    """``UTurnEnv._make_vehicles``; only the first driver is drawn."""
    vehicles = []
    for k, (lane, s, speed) in enumerate(u_turn.SLOTS[:U_TURN_VEHICLES]):
        s, speed = s + rng.normal() * DEVIATION, speed + rng.normal() * DEVIATION
        driver = _driver(road, _delta(rng) if k == 0 else DELTA)
        vehicles.append(make_on_lane(road, f"v{k}", lane, s, speed, driver, destination="d"))
    return tuple(vehicles)


def _intersection(config: Config, road: Road, rng: Random) -> Vehicles:
    """The first part of ``IntersectionEnv._make_vehicles``: the others, before three seconds of traffic."""
    count = int(config["initial_vehicle_count"])
    vehicles: list[VehicleSpec] = []
    for k, place in enumerate(np.linspace(0, 80, count)[:-1] if count > 0 else ()):
        there = [(v.x, v.y) for v in vehicles]
        vehicle = _arrival(f"v{k}", road, rng, there, INITIAL_SPAWN_PROBABILITY, float(place))
        if vehicle is not None:
            vehicles.append(vehicle)
    return tuple(vehicles)


def _merge(config: Config, road: Road, rng: Random) -> Vehicles:
    """``MergeEnv._make_vehicles``."""
    vehicles = [
        make_on_lane(road, f"v{k}", *place, _driver(road)) for k, place in enumerate(merge.places(rng))
    ]
    ramp = road, merge.MERGING, merge.RAMP, 110.0, 20.0, _driver(road)
    return (*vehicles, make_on_lane(*ramp, target_speed=merge.WANTED))


def _exit(config: Config, road: Road, ego: VehicleSpec, rng: Random) -> Vehicles:
    """``ExitEnv._create_vehicles``."""
    how: dict[str, Any] = {"destination": exit.AHEAD, "changes_lanes": False}
    drawn = enumerate(exit.places(config, road, ego.s, rng))
    return tuple(make_on_lane(road, f"v{k}", *place, _driver(road), **how) for k, place in drawn)


_OTHERS = {"two-way": _two_way, "roundabout": _roundabout, "u-turn": _u_turn, "merge": _merge}


# -- arrivals -----------------------------------------------------------------------------------------------------


def arrival(config: Config, road: Road, rng: Random, centres: Centres, step: int) -> Spawn | None:
    """The vehicle that arrives at the intersection after this policy step; `centres` of those that are there [m]."""
    vehicle = _arrival(f"s{step}", as_rotated(road), rng, centres, config["spawn_probability"])
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
    lane = (f"o{start}", f"ir{start}", 0)
    vehicle = make_on_lane(road, id, lane, s, speed, _driver(road), destination=f"o{goal}")
    if not fits(vehicle, centres):
        return None
    return vehicle._replace(driver=_driver(road, _delta(rng)))


# -- vehicles -----------------------------------------------------------------------------------------------------


def _delta(rng: Random) -> float:
    """``IDMVehicle.randomize_behavior``."""
    return float(rng.uniform(*DELTA_RANGE))


def _driver(road: Road, delta: float = DELTA) -> Driver:
    return replace(DRIVERS[road.name], delta=delta)


def with_other_drivers(scenario: Scenario, seed: int) -> Scenario:
    """The scenario with another driver in every vehicle but learning cars.

    A driver of a pool is replaced by one of the same pool. Of highway-env's own drivers the exponent of IDM is drawn,
    which is what ``IDMVehicle.randomize_behavior`` draws, unless it is the one that drivers have without it. The seed
    of the scenario becomes this one, which decides on `linear.linear_drivers`.
    """
    rng = stream(seed, "imagined drivers")
    pool_of = {driver.type: pool.drivers for pool in scenario.pools for driver in pool.drivers}

    def other(driver: Driver) -> Driver:
        if pool := pool_of.get(driver.type):
            return pool[rng.integers(len(pool))]
        return replace(driver, delta=_delta(rng)) if driver.delta != DELTA else driver

    return replace(scenario.with_drivers(other), seed=seed)
