"""Driving along a route of any SUMO network, among the traffic of a route file or of routes (`SumoDrivingEnv`)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from sumo_env.config import DISCRETE_META_ACTION, Config, ConfigError
from sumo_env.networks import files
from sumo_env.networks.lanes import VEHICLE_LENGTH
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.streams import stream
from sumo_env.tasks.base import Drivers, EgoState, Task, ego_driver, make_on_lane, speed_term
from sumo_env.tasks.demand import RIGHTMOST, Departure, Entry, read
from sumo_env.tasks.way import Way
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, Spawn, VehicleSpec, fits

EGO_ROUTE = "ego"
MARGIN = VEHICLE_LENGTH  # [m] that a vehicle keeps from both ends of an edge when it is placed
END = 0.1  # [m] that the front of a vehicle keeps from the end of a lane when it is placed
SPACING = 15.0  # [m] between centres when vehicles are placed
EGO_SPACING = 25.0  # [m] likewise, from the ego


class NetworkTask(Task):
    """The ego drives along its route: fast, without a crash, and in the lanes that lead on."""

    name = "network"
    defaults = {
        "observation": {
            "type": "Kinematics",
            "vehicles_count": 10,
            "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h", "cos_d", "sin_d"],
            "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-40, 40], "vy": [-40, 40]},
        },
        "action": DISCRETE_META_ACTION,
        "vehicles_count": 20,  # placed at random on the routes, beside those of a route file
        "spawn_probability": 0.3,  # [1/s] that a vehicle comes at the beginning of a route
        "obey_traffic_lights": False,  # whether the ego stops at red and yellow lights, whatever the agent does
        "initial_speed": None,  # of the ego [m/s]; None for two thirds of the speed limit
        "duration": 60,  # [s]
        "collision_reward": -1,
        "high_speed_reward": 0.4,
        "arrived_reward": 1,
        "missed_turn_reward": -1,
        "reward_speed_range": None,  # [m/s]; None for half the speed limit to the speed limit
        "offroad_terminal": False,
        "screen_width": 600,
        "screen_height": 600,
        "centering_position": [0.5, 0.5],
    }
    risk_rates = RiskRates(cut_in=0.05, brake=0.05, surge=0.05)

    def __init__(
        self,
        network: str | Path,
        routes: str | Path | Mapping[str, Sequence[str]] | Sequence[Sequence[str]],
        ego_route: Sequence[str],
    ) -> None:
        """See `sumo_env.env.SumoDrivingEnv`; errors are ValueErrors."""
        self.net = str(Path(network).resolve())
        self._demand: tuple[Entry, ...] = ()
        if isinstance(routes, str | Path):
            named, self._demand = read(Path(routes), partial(files.shortest, self.net))
            # what a file says is all the traffic there is, unless more is asked for
            self.defaults = {**self.defaults, "vehicles_count": 0, "spawn_probability": 0.0}
        else:
            items = list(routes.items() if isinstance(routes, Mapping) else enumerate(routes))
            for name, way in items:
                if isinstance(way, str):
                    raise ConfigError(f"route {name} must be a list of edges, not {way!r}")
            named = {f"route {name}": tuple(way) for name, way in items}
        if not ego_route or isinstance(ego_route, str):
            raise ConfigError(f"ego_route must be a list of edges, not {ego_route!r}")
        self.routes = {**named, EGO_ROUTE: tuple(ego_route)}
        users: dict[str, set[str]] = {name: set() for name in self.routes}
        for entry in self._demand:
            for name, _ in entry.routes:
                users[name] |= entry.vehicles
        self._others = tuple(name for name in named if files.CAR in (users[name] or {files.CAR}))
        self._network = driven = files.network(self.net, self._routes)
        for name, classes in users.items():
            for vehicles in sorted(classes or {files.CAR}):
                files.check_route(driven, name, self.routes[name], vehicles)
        for entry in self._demand:
            for (name, _), vehicles in product(entry.routes, entry.vehicles):
                self._departure_lanes(entry, name, vehicles)
        self._way = Way(driven, self.routes[EGO_ROUTE], VEHICLE_LENGTH)
        self.ego_road = files.lane(ego_route[0])[:2]
        limit = self._way.limit
        if type(self).target_speeds is Task.target_speeds:  # else a subclass has speeds of its own
            self.target_speeds = (0.0, round(limit / 2, 2), round(limit, 2))

    # -- traffic -------------------------------------------------------------------------------------------

    def ego(self, config: Config, road: Road, rng: np.random.Generator) -> VehicleSpec:
        fastest = max(config["action"].get("target_speeds") or self.target_speeds)
        if fastest / config["policy_frequency"] > self._way.limit:
            raise ConfigError(
                f"the ego may drive at most {self._way.limit:g} m (one second at the speed limit) in a policy step: "
                "lower its 'target_speeds', or raise 'policy_frequency'"
            )
        starts = self._way.starts
        index: LaneIndex = (*self.ego_road, starts[int(rng.integers(len(starts)))])
        speed = config["initial_speed"]
        speed = 2 / 3 * road.lane(index).speed_limit if speed is None else float(speed)
        return _placed(road, EGO, index, MARGIN, speed, ego_driver(self), EGO_ROUTE)

    def vehicles(
        self, config: Config, road: Road, ego: VehicleSpec, rng: np.random.Generator, drivers: Drivers
    ) -> list[VehicleSpec]:
        vehicles: list[VehicleSpec] = []
        for departure in (one for entry in self._demand for one in entry.departures(rng, -math.inf, 0.0)):
            vehicle = self._departing(departure, road, rng, drivers)
            if fits(vehicle, [(other.x, other.y) for other in (ego, *vehicles)]):
                vehicles.append(vehicle)
        roomy = {route: _roomy(road, self.routes[route]) for route in self._others}
        routes = [route for route in self._others if roomy[route]]
        for number in range(int(config["vehicles_count"]) if routes else 0):
            for _ in range(100):
                route = routes[int(rng.integers(len(routes)))]
                edge = roomy[route][int(rng.integers(len(roomy[route])))]
                place = _anywhere(road, edge, rng)
                x, y = road.lane(place[0]).position(place[1], 0.0)
                near = any(math.hypot(x - v.x, y - v.y) < SPACING for v in vehicles)
                if not near and math.hypot(x - ego.x, y - ego.y) >= EGO_SPACING:
                    break
            else:  # the roads are full
                break
            limit = road.lane(place[0]).speed_limit
            speed = float(rng.uniform(0.5, 0.8)) * limit
            vehicles.append(_placed(road, f"v{number}", *place, speed, drivers.next(), route, limit))
        return vehicles

    def spawns(self, config: Config, road: Road, seed: int, drivers: Drivers) -> list[Spawn]:
        rng, frequency = stream(seed, "spawns"), config["policy_frequency"]
        steps = math.ceil(config["duration"] * frequency)
        soon = math.nextafter(0.0, 1.0)
        found = [
            Spawn(math.ceil(departure.time * frequency), self._departing(departure, road, rng, drivers))
            for entry in self._demand
            for departure in entry.departures(rng, soon, float(config["duration"]))
        ]
        for step in range(1, steps + 1) if self._others else ():
            if rng.random() < config["spawn_probability"] / frequency:
                route = self._others[int(rng.integers(len(self._others)))]
                departure = Departure(f"s{step}", route, 0.0, None, 2 * MARGIN, None, None)
                found.append(Spawn(step, self._departing(departure, road, rng, drivers)))
        return found

    def _departing(
        self, departure: Departure, road: Road, rng: np.random.Generator, drivers: Drivers
    ) -> VehicleSpec:
        vehicles = files.CAR if departure.kind is None else departure.kind.vehicles
        lanes = self._departure_lanes(departure, departure.route, vehicles)
        index = lanes[int(rng.integers(len(lanes)))] if departure.lane is None else lanes[0]
        lane = road.lane(index)
        drawn = float(rng.uniform(2 * MARGIN, max(lane.length - MARGIN, 2 * MARGIN)))
        front = drawn if departure.front is None else departure.front % lane.length
        speed = lane.speed_limit if departure.speed is None else departure.speed
        driver: Driver = drivers.next()
        factor = 1.0
        if departure.kind is not None:
            factor = departure.kind.factor(rng)
            driver = driver.like(departure.kind.name, departure.kind.attributes)
        s = max(front - driver.size[0] / 2, 0.0)
        wanted = factor * lane.speed_limit
        return _placed(road, departure.id, index, s, speed, driver, departure.route, wanted)

    def _departure_lanes(self, departure: Departure | Entry, route: str, vehicles: str) -> list[LaneIndex]:
        """The lanes in which a vehicle may depart; SUMO's number counts all lanes, pavements too."""
        edge = self.routes[route][0]
        lanes = files.lanes_for(self._network, edge, vehicles)
        if departure.lane == RIGHTMOST:
            lanes = lanes[-1:]
        elif departure.lane is not None:
            lanes = [index for index in lanes if self._network.lanes[index].id == f"{edge}_{departure.lane}"]
        if not lanes:
            raise ConfigError(
                f"{departure.id!r} departs on lane {departure.lane} of edge {edge!r}, which has no such lane for "
                f"vehicles of class {vehicles!r}"
            )
        length = self._network.road.lane(lanes[0]).length
        if departure.front is not None and abs(departure.front) > length + SPACING:
            raise ConfigError(
                f"{departure.id!r} departs at {departure.front:g} m of edge {edge!r}, which is {length:.0f} m long"
            )
        return lanes

    # -- reward and end ------------------------------------------------------------------------------------

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        limits = config["reward_speed_range"] or [self._way.limit / 2, self._way.limit]
        return {
            "collision_reward": float(ego.crashed),
            "high_speed_reward": speed_term(ego.speed, limits),
            "arrived_reward": float(self.arrived(ego)),
            "missed_turn_reward": float(self._missed_turn(ego)),
            "on_road_reward": float(ego.on_road),
        }

    def arrived(self, ego: EgoState) -> bool:
        return self._way.remaining(ego) < self._way.zone

    def terminated(self, ego: EgoState, config: Config) -> bool:
        return super().terminated(ego, config) or self._missed_turn(ego)

    def _missed_turn(self, ego: EgoState) -> bool:
        """Whether the ego is about to get to the end of a lane that does not lead on along its route."""
        return self._way.free(ego) < self._way.zone


def _placed(
    road: Road,
    id: str,
    index: LaneIndex,
    s: float,
    speed: float,
    driver: Driver,
    route: str,
    target_speed: float | None = None,
) -> VehicleSpec:
    """A vehicle with its front on the lane, at `s` [m] or, if that is beyond, at the lane's end."""
    lane = road.lane(index)
    s = min(s, lane.length - driver.size[0] / 2 - END)
    inside = make_on_lane(road, id, index, 0.0, speed, driver, destination=route, target_speed=target_speed)
    x, y = lane.position(s, 0.0)
    return inside._replace(s=s, x=x, y=y, heading=lane.heading_at(s))


def _roomy(road: Road, way: Sequence[str]) -> list[str]:
    """The edges of a route on which a vehicle can be placed at random."""
    return [edge for edge in way if road.lane(files.lane(edge)).length >= 2 * MARGIN]


def _anywhere(road: Road, edge: str, rng: np.random.Generator) -> tuple[LaneIndex, float]:
    """A lane of an edge, and a place on it [m]."""
    start, end, _ = files.lane(edge)
    index = (start, end, int(rng.integers(road.count(start, end))))
    return index, float(rng.uniform(MARGIN, max(road.lane(index).length - MARGIN, MARGIN + 0.1)))
