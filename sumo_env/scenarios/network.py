"""Driving through any SUMO scenario: SUMO's own files, or routes among which traffic is drawn (`SumoDrivingEnv`)."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from sumo_env.config import DISCRETE_META_ACTION, MOST_VEHICLES, Config, ConfigError, names_of, warn_once
from sumo_env.networks import files
from sumo_env.networks.roads import Road
from sumo_env.scenarios.configuration import configuration, is_configuration, paths, seconds
from sumo_env.scenarios.file_checks import UNSORTED, check_files
from sumo_env.scenarios.random_traffic import elements
from sumo_env.scenarios.reward_terms import TERMS, measures_energy, terms
from sumo_env.scenarios.risky import LACKING
from sumo_env.scene import CLOSING, FOE, GAPS, LANE_ENDS, ON_ITS_WAY, ON_REQUEST
from sumo_env.streams import stream
from sumo_env.sumo.paths import is_output, listed, plain_path
from sumo_env.sumo.settings import COLLISIONS
from sumo_env.tasks.base import EgoState, Task, ego_driver, make_on_lane, speed_term
from sumo_env.traffic.risk import RiskRates
from sumo_env.traffic.scenario import EGO, Origin, Scenario, SumoTraffic

Route = Sequence[str]
QUIET = 60.0  # [s] without a departure after which SUMO's begin is not taken, unless it was given
STEP = "0.1"  # [s]
MOST_SCALED = 100  # times the traffic
SIDE_RANGE = 50.0  # [m] to the sides that the observation shows: a lane is a sixteenth of it
# What a task of SUMO's files is never asked, and what says it there.
NOT_ASKED = {
    "ego": "the ego is where its route or its vehicle begins",
    "vehicles": "the files or the routes say who drives",
    "spawns": "the files or the routes say who comes",
    "events": "vehicles come later than events are drawn: 'risk_rates' and 'own_kinds' say what they do",
}


class NetworkTask(Task):
    """The ego drives along its route: fast, without a crash, and in the lanes that lead on."""

    name = "network"
    of_files = True
    defaults = {
        "observation": {
            "type": "Kinematics",
            "vehicles_count": 10,
            "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h", *ON_ITS_WAY],
        },
        "action": DISCRETE_META_ACTION,
        "vehicles_count": 20,  # placed at random on the routes that are given as lists
        "spawn_probability": 0.3,  # [1/s] that a vehicle comes at the beginning of such a route
        "traffic_scale": [1, 1],  # numbers between which a factor on all traffic is drawn for each episode
        "begin": None,  # [s] of SUMO's clock; None for the begin of the files, or their first departure
        "warm_up": 0,  # [s] that the traffic drives before the ego comes
        "wait": 600,  # [s] that SUMO may need to insert the ego
        "obey_traffic_lights": False,  # whether the ego stops at red and yellow lights, whatever the agent does
        "overlaps_are_crashes": False,  # also where SUMO lets vehicles pass whose outlines touch (docs/collisions.md)
        "initial_speed": None,  # of the ego [m/s]; None for SUMO's choice
        "duration": 60,  # [s]
        # A crash costs what the whole way and the arrival bring, at any policy frequency.
        "progress_reward": 5,  # for the whole way
        "arrived_reward": 5,
        "collision_reward": -10,
        "missed_turn_reward": -5,
        "red_light_reward": -5,
        "high_speed_reward": 0,  # in each policy step
        "red_light_terminal": False,  # whether the episode ends when the ego runs a red light
        "reward_speed_range": None,  # [m/s]; None for half the speed limit to the speed limit
        **TERMS,
        "offroad_terminal": False,
        "screen_width": 600,
        "screen_height": 600,
        "centering_position": [0.5, 0.5],
    }
    risk_rates = RiskRates(cut_in=0.05, brake=0.05, surge=0.05)

    def __init__(
        self,
        network: str | Path,
        routes: Any = (),
        ego_route: Sequence[str] | Sequence[Route] = (),
        *,
        additional: str | Path | Sequence[str | Path] = (),
        ego_trips: Sequence[tuple[str, str]] = (),
        ego_vehicle: str = "",
        ego_type: str = "",
        vehicles: Sequence[str] = (),
        vehicle_type: str = "",
        max_cars: int = 0,
    ) -> None:
        """See `SumoDrivingEnv`, and of the last three `sumo_env.parallel`; errors are ValueErrors."""
        for name, instead in NOT_ASKED.items():
            if getattr(type(self), name) is not getattr(Task, name):
                raise ConfigError(f"{type(self).__name__}.{name} is never asked: on SUMO's files {instead}")
        words = {"ego_vehicle": ego_vehicle, "ego_type": ego_type, "vehicle_type": vehicle_type}
        for name, word in words.items():
            if not isinstance(word, str | None):
                raise ConfigError(f"{name} must be an id of SUMO's files, such as '0', not {word!r}")
        if len(set(vehicles := names_of("vehicles", vehicles))) < len(vehicles):
            raise ConfigError(f"vehicles must be different ids, not {vehicles!r}")
        (file,) = paths("network", network)
        if is_configuration(file):
            options = configuration(file)
            self.outputs = tuple((name, value) for name, value in options.items() if is_output(name))
            options = {name: value for name, value in options.items() if not is_output(name)}
            for name, value in COLLISIONS.items():
                if options.get(name, value) != value:
                    warn_once(
                        f"{file}: {name}={options[name]} is replaced by {value}: contacts change nothing here"
                    )
        else:
            options = {"net-file": str(plain_path(file))}
        drawn = self._take_routes(routes, options)
        if added := paths("additional", additional):
            options["additional-files"] = listed(options.get("additional-files"), *added)
        self._options = options
        contents = self._contents = check_files(options)
        self._driven = files.network(options["net-file"])
        self.net = str(self._driven.net_file)
        for name, way in self._drawn:
            files.check_route(self._driven, name, way)
        self._first = None if "begin" in options else contents.first_departure
        if left_out := contents.left_out:
            some = ", ".join(left_out[:5]) + (", ..." if len(left_out) > 5 else "")
            warn_once(f"SUMO leaves out {len(left_out)} of the files ({some}): {UNSORTED}")
        if contents.people:
            warn_once(f"{file} has people on foot: no agent sees them, and no contact with them is noticed")
        self._learning = (ego_vehicle,) if ego_vehicle else tuple(vehicles)  # cars of the files
        self._car_type, self.max_cars = vehicle_type, max_cars or max(len(self._learning), 1)
        self._origins = self._take_ego(ego_route, ego_trips, ego_type)
        for vehicle in self._learning:
            contents.check_vehicle(vehicle)
        if vehicle_type:
            contents.check_type(vehicle_type)
        added_ids = (id for id in (EGO, "learner", "learner.0") if id not in contents.ids)
        self.ego_id = self._learning[0] if self._learning else next(added_ids)
        self._limit = self._speed_limit()
        if type(self).target_speeds is Task.target_speeds:  # else a subclass has speeds of its own
            self.target_speeds = (0.0, round(self._limit / 2, 2), round(self._limit, 2))
        self._take_defaults(options, drawn)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> NoReturn:
            hint = "" if "_limit" in vars(self) else ": its __init__ has to call super().__init__()"
            raise AttributeError(f"{type(self).__name__!r} has no attribute {name!r}{hint}", name=name)

    def _take_defaults(self, options: Mapping[str, str], drawn: bool) -> None:
        """Keys whose defaults follow the files; drawn: whether there is traffic beside theirs."""
        # what a Kinematics table has unless it is said; a subclass may see something else
        table = {**NetworkTask.defaults["observation"], "features_range": _ranges(self._limit)}
        seen = self.defaults.get("observation", table)
        if seen["type"] == table["type"]:
            seen = table = {**table, **seen}
        self.table = table
        self.defaults = {
            **self.defaults,
            "observation": seen,
            "simulation_frequency": _frequency(options.get("step-length", STEP)),
        }
        if not drawn:  # what files say is all the traffic there is
            self.defaults = {**self.defaults, "vehicles_count": 0, "spawn_probability": 0.0}

    def _take_routes(self, routes: Any, options: dict[str, str]) -> bool:
        """Sort out files of SUMO from routes among which traffic is drawn; returns whether there are such routes."""
        if isinstance(routes, str | Path):
            routes = [routes]
        several = routes.items() if isinstance(routes, Mapping) else enumerate(routes)
        named = [(f"route {name}", way) for name, way in several]
        are_files = [
            isinstance(way, Path) or (isinstance(way, str) and (files.is_file(way) or os.path.isfile(way)))
            for _, way in named
        ]
        self._drawn: tuple[tuple[str, tuple[str, ...]], ...] = ()
        if named and all(are_files):
            added = paths("routes", [way for _, way in named])
            options["route-files"] = listed(options.get("route-files"), *added)
            return False
        for name, way in named:
            if isinstance(way, str | Path) or not way:
                raise ConfigError(f"{name} must be a list of edges, or all of routes files, not {way!r}")
        self._drawn = tuple((name, names_of(name, way)) for name, way in named)
        return bool(named) or "route-files" not in options

    def _take_ego(self, route: Any, trips: Sequence[tuple[str, str]], type: str) -> tuple[Origin, ...]:
        """The ways in which the ego may come; one is drawn for each episode."""
        is_of_files = bool(self._learning or self._car_type)
        ways = {"ego_route": route, "ego_trips": trips, "ego_vehicle": is_of_files}
        given = [name for name, way in ways.items() if way]
        if len(given) != 1:
            gave = f"both {' and '.join(given)}" if given else "none"
            raise ConfigError(f"the ego needs exactly one of {', '.join(ways)}; you gave {gave}")
        if is_of_files:
            if type:
                raise ConfigError("ego_type is for an ego that is added: a vehicle of the files has its own")
            return (Origin(),)
        kind = type or ("ego" if self._drawn else Origin().type)
        if trips:
            if not all(isinstance(trip, list | tuple) and len(trip) == 2 for trip in trips):
                raise ConfigError(f"ego_trips must be pairs of edges, not {trips!r}")
            origins = tuple(Origin(tuple(trip), True, kind) for trip in trips)
        else:
            if isinstance(route, str | Mapping):
                raise ConfigError(f"ego_route must be a list of edges, not {route!r}")
            several = [route] if isinstance(route[0], str) else route
            origins = tuple(Origin(names_of("ego_route", way), False, kind) for way in several)
        for origin in origins:
            vehicles = "" if type else files.CAR
            if origin.is_trip:
                files.check_trip(self._driven, origin.edges[0], origin.edges[-1], vehicles)
            else:
                files.check_route(self._driven, "the ego's", origin.edges, vehicles)
        return origins

    def _speed_limit(self) -> float:
        """The highest on the ego's routes [m/s]; where these are found later, on the whole network."""
        road = self._driven.road
        edges = {edge for origin in self._origins for edge in origin.edges if not origin.is_trip}
        lanes = [index for edge in edges for index in files.lanes_for(self._driven, edge, "")]
        ego_lanes = lanes or [index for index in road.lanes if index[0].endswith(":from")]
        self.ego_road = max(ego_lanes, key=lambda index: road.count(*index[:2]))[:2]
        return max(road.lane(index).speed_limit for index in ego_lanes)

    # -- what SUMO loads -----------------------------------------------------------------------------------

    def road(self, config: Config) -> Road:
        return self._driven.road

    def frequency(self, config: Config) -> int:
        return int(config["simulation_frequency"])

    def scenario(self, config: Config, seed: int) -> Scenario:
        """Draw the scenario number `seed`: the ego's way, and what is drawn of the traffic."""
        named = {name: model for name, model in self._contents.models.items() if model}
        models = tuple(named.items()) if config["risk"] else ()
        for model in sorted({model for _, model in models} & LACKING.keys()):
            lacks = ", ".join(LACKING[model])
            warn_once(f"risk changes no {lacks} of drivers of the car-following model {model}")
        rng = stream(seed, "scenario")
        origin = self._origins[int(rng.integers(len(self._origins)))]
        if config["initial_speed"] is not None:
            origin = replace(origin, speed=f"{config['initial_speed']:g}")
        first = files.lanes_for(self._driven, origin.edges[0], "")[0] if origin.edges else (*self.ego_road, 0)
        spec = make_on_lane(self._driven.road, self.ego_id, first, 0.0, 0.0, ego_driver(self))
        begin = self._begin(config)
        options = {**self._options, "step-length": f"{1.0 / self.frequency(config):.6g}"}
        if begin is not None:
            options["begin"] = f"{begin:.12g}"
        start, drawn = seconds("begin", options.get("begin", "0")), ""
        scale = self._scale(config, seed)
        without_effect = not self._drawn and (config["vehicles_count"] or config["spawn_probability"])
        if without_effect and "route-files" in options:
            warn_once("'vehicles_count', 'spawn_probability' have no effect on files: use 'traffic_scale'")
        if self._drawn:
            for key, most in (("vehicles_count", MOST_VEHICLES), ("spawn_probability", 1.0)):
                config = {**config, key: min(scale * config[key], most)}
            drawn = elements(self, self._driven, self._drawn, config, spec, start, rng, seed)
        elif scale != 1.0:
            options["scale"] = f"{scale * float(options.get('scale', 1.0)):.6g}"
        return Scenario(
            task=self.name,
            seed=seed,
            risk=config["risk"],
            ego=spec,
            vehicles=(),
            simulation_frequency=self.frequency(config),
            policy_frequency=int(config["policy_frequency"]),
            net=self.net,
            warm_up=float(config["warm_up"]),
            obeys_lights=bool(config["obey_traffic_lights"]),
            traffic=SumoTraffic(
                options=tuple(options.items()),
                origin=origin,
                elements=drawn,
                wait=float(config["wait"]),
                ranges=self.risk_ranges,
                rates=self.risk_rates,
                own_kinds=self.own_kinds,
                models=models,
                arrivals=tuple(self._contents.arrivals.items()),
                removing=frozenset(self._contents.removing),
                duration=float(config["duration"]),
                measures_energy=measures_energy(config),
                sees_foes=not {*FOE}.isdisjoint(config["observation"].get("features") or ()),
                overlaps_are_crashes=bool(config["overlaps_are_crashes"]),
                car_type=self._car_type,
                max_cars=self.max_cars,
            ),
            further=self._learning[1:],
        )

    def _scale(self, config: Config, seed: int) -> float:
        """The factor on the traffic of an episode."""
        low, high = config["traffic_scale"]
        if not 0.0 <= low <= high <= MOST_SCALED:
            raise ConfigError(
                f"'traffic_scale' must be [low, high] from 0 to {MOST_SCALED}, not {[low, high]!r}"
            )
        if low < 1.0 and self._learning:
            raise ConfigError(
                f"'traffic_scale' must be from 1 on, not {[low, high]!r}: SUMO may leave out an ego of the files; "
                "take ego_route or ego_trips"
            )
        return float(stream(seed, "traffic scale").uniform(low, high)) if low < high else float(low)

    def _begin(self, config: Config) -> float | None:
        """Where SUMO's clock begins [s]; None where the files say it."""
        if config["begin"] is not None or self._first is None or self._first < QUIET:
            return None if config["begin"] is None else float(config["begin"])
        warn_once(f"the first vehicle of the files departs at {self._first:g} s: 'begin' is set to it")
        return self._first

    def imagined(self, scenario: Scenario, config: Config, now: float, seed: int) -> Scenario:
        assert scenario.traffic is not None
        imagined = (*scenario.traffic.imagined, (now, seed))
        return replace(scenario, traffic=replace(scenario.traffic, imagined=imagined), tilt=None)

    # -- reward and end ------------------------------------------------------------------------------------

    def rewards(self, ego: EgoState, config: Config) -> dict[str, float]:
        limits = config["reward_speed_range"] or [self._limit / 2, self._limit]
        place = ego.place
        return {
            "progress_reward": place.progress,
            "collision_reward": float(ego.crashed),
            "high_speed_reward": speed_term(ego.speed, limits),
            "arrived_reward": float(self.arrived(ego)),
            "missed_turn_reward": float(place.ended == "missed turn"),
            "red_light_reward": float(place.red_lights),
            **terms(ego, config),
        }

    def arrived(self, ego: EgoState) -> bool:
        return ego.place.ended == "arrived"

    def terminated(self, ego: EgoState, config: Config) -> bool:
        place = ego.place
        ran_red = place.red_lights > 0 and bool(config["red_light_terminal"])
        return super().terminated(ego, config) or ran_red


def _ranges(limit: float) -> dict[str, list[float]]:
    """Ranges of features where roads are driven at up to `limit` [m/s]: five seconds ahead, and oncoming vehicles."""
    sight = max(5.0 * limit, 50.0)
    ranges = {"x": [-sight, sight], "y": [-SIDE_RANGE, SIDE_RANGE]}
    ranges |= {name: [-2.0 * limit, 2.0 * limit] for name in ("vx", "vy")}
    ranges |= {name: [0.0, sight] for name in (*LANE_ENDS, "light_distance", *GAPS)}
    ranges["foe_gap"] = [0.0, 2.0 * sight]  # the ego needs time to cross
    ranges |= {name: [0.0, limit] for name in ON_REQUEST[2:]}
    return {**ranges, "light": [-1.0, 2.0], **{name: [-limit, limit] for name in CLOSING}}


def _frequency(step: str) -> int:
    """Steps per second [Hz] of a step length."""
    if not 0.0 < (length := seconds("step-length", step)) < inf:
        raise ConfigError(f"step-length={step!r} must be a time above 0 s")
    frequency = 1.0 / length
    if round(frequency) >= 1 and abs(frequency - round(frequency)) < 1e-6 * frequency:
        return round(frequency)
    warn_once(f"a second is no whole number of steps of {step} s: 'simulation_frequency' is 10")
    return 10
