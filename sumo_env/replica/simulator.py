"""`Replica`: highway-env's physics without SUMO, as a `sumo_env.simulator.Simulator`."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from sumo_env.contacts.crash import CrashRecord, crash_record
from sumo_env.contacts.rectangles import separation, state_of
from sumo_env.networks.roads import LaneIndex, Road, highway
from sumo_env.observation import Kinematics
from sumo_env.replica import sight, tables
from sumo_env.replica import step as kernels
from sumo_env.replica.compiled import announced
from sumo_env.replica.linear import linear_drivers
from sumo_env.replica.step import CRASHED, HEADING, IN_EVENT, SPEED, Rules, X, Y
from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand, Step
from sumo_env.traffic.scenario import EGO_DISTANCE, SPAWN_DISTANCE, Scenario, Spawn, VehicleSpec

Centres = Sequence[tuple[float, float]]  # [m]

VARIANTS = ("stock", "path", "connected", "v0")
NOBODY: frozenset[str] = frozenset()
JOINED = ("roundabout", "intersection", "u-turn")  # tasks with lanes that continue others

FRAME = ("x", "y", "speed", "heading", "crashed", "in_event")  # the rows of a frame of a trace


class Start(NamedTuple):
    """An episode before its first step, for the kernels.

    Attributes:
        lanes, seen_lanes: records of LANE, for the traffic and for the ego's eyes.
        rules: of the task.
        warmed_up: sub-steps that were driven before.
        cars: records of CAR, the ego first.
        arrivals, arrival_steps: cars that come later, and the policy steps after which they do, rising.
        events: records of EVENT.
        first_arrival: see `step.policy_step`.
    """

    lanes: tables.Records
    seen_lanes: tables.Records
    rules: Rules
    warmed_up: int
    cars: tables.Records
    arrivals: tables.Records
    arrival_steps: np.ndarray
    events: tables.Records
    first_arrival: int


class Replica:
    """highway-env's drivers, steering, right of way and contacts, compiled.

    Args:
        variant: how far drivers see beyond the end of their lane (roundabout, intersection and u-turn; the lanes of the
            other two roads continue no others): "v0": not at all; "connected": onto the next lanes, distances
            projected, as in highway-env with connected lanes; "path": onto the next lanes, distances along the path.
            "stock" is highway-env as it is installed: "v0" or, if `connected`, "connected", and the ego of the
            intersection comes last in the order of vehicles, not first.
        is_linear: whether a scenario's dose of risk means `linear_drivers` (``risk_law`` "linear").
        ego_contacts: whether only the ego's contacts are looked at, as in highway-fast-v0.

    Raises:
        ValueError: unknown variant.
    """

    def __init__(self, variant: str = "path", is_linear: bool = False, ego_contacts: bool = False) -> None:
        if variant not in VARIANTS:
            raise ValueError(f"the variant must be one of {VARIANTS}, not {variant!r}")
        _load()
        self.variant, self.is_linear, self.ego_contacts = variant, is_linear, ego_contacts
        self.connected = False  # whether drivers of the variant "stock" look onto the next lanes
        self._rules = Rules(along_path=False, is_two_way=False, regulation_interval=0, dt=0.0)
        self._scenario: Scenario | None = None
        self._ids: list[str] = []
        self._everybody: tables.Records
        self._warm: tuple[tuple[VehicleSpec, ...], tables.Records] | None = None

    def reset(self, scenario: Scenario) -> Scene:
        """See `Simulator.reset`."""
        self.load(scenario)
        self._name_cars()
        return self._scene(np.array([self._cars[name] for name in FRAME], float))

    def load(self, scenario: Scenario) -> Start:
        """Place a scenario and drive its warm-up."""
        self._prepare(scenario.road, scenario.simulation_frequency)
        self._read(scenario)
        self._spawns: dict[int, tuple[int, ...]] = {}  # policy step -> numbers
        for number, spawn in enumerate(scenario.spawns, start=len(scenario.specs)):
            self._spawns[spawn.step] = (*self._spawns.get(spawn.step, ()), number)
        self._next_event = self._steps = self._policy_steps = 0
        self._crash: CrashRecord | None = None
        self._warmed_up = round(scenario.warm_up * scenario.simulation_frequency)
        placed = self._everybody[: len(scenario.specs)]
        self._cars = self._with_ego(placed) if self._warmed_up else tables.chosen(placed, slice(None))
        present = len(placed) + len(self._spawns.get(0, ()))
        self._first_arrival = present if self.variant == "stock" and self._warmed_up else 0
        steps = np.array([step for step, numbers in self._spawns.items() for _ in numbers if step], np.int64)
        self.start = Start(
            self._lanes.table,
            self._seen_lanes,
            self._rules,
            self._warmed_up,
            self._cars,
            self._everybody[present:],
            steps,
            self._events,
            self._first_arrival,
        )
        return self.start

    def step(self, command: EgoCommand, trace: bool = False) -> Step:
        """See `Simulator.step`."""
        scenario = self._scenario
        if scenario is None:
            raise RuntimeError("call reset() before step()")
        if self._policy_steps > 0 and scenario.road.name == "intersection":
            self._let_out_and_in()
        ego = self._cars[0]
        ego["target_speed"] = command.target_speed
        self._steer_ego_for(command.target_lane)
        substeps = scenario.simulation_frequency // scenario.policy_frequency
        frames = np.empty((substeps, len(FRAME), len(self._cars)))
        self._next_event, crash, min_ttc, distance = kernels.policy_step(
            self._lanes.table, self._cars, self._events, self._next_event, self._rules, self._steps,
            substeps, self._warmed_up, self._first_arrival, frames,
        )  # fmt: skip
        start, self._steps = self._steps, self._steps + len(frames)
        self._policy_steps += 1
        scene = self._scene(frames[-1])
        if crash >= 0 and self._crash is None:
            self._crash = _record(self._scene(frames[crash], start + crash + 1))
        return Step(
            scene=scene,
            target_lane=self._lanes.names[ego["target"]],
            crash=self._crash,
            min_ttc=min_ttc,
            distance=distance,
            trace=tuple(self._scene(frame, start + k + 1) for k, frame in enumerate(frames)) if trace else (),
        )

    def ego_place(self) -> tuple[LaneIndex, float, float, bool]:
        """The ego's lane, its coordinates on it (s and lat) [m], and whether it is on the road."""
        lane, s, lateral, is_on_road = sight.ego_place(self._seen_lanes, self._cars)
        return self._lanes.names[lane], s, lateral, is_on_road

    def table(self, eyes: sight.Eyes) -> np.ndarray:
        """The Kinematics observation."""
        table = np.empty((eyes.rows, len(eyes.features)), np.float32)
        sight.look(self._seen_lanes, self._cars, eyes, table)
        return table

    def warm_up(self, road: Road, vehicles: tuple[VehicleSpec, ...], time: float, frequency: int) -> Centres:
        """Centres of vehicles after they have driven for a time [s] without an ego.

        `reset` with a scenario of these vehicles takes over what was driven.
        """
        self._prepare(road, frequency)
        self._warmed_up = round(time * frequency)
        cars = tables.cars_of(road, vehicles)
        cars["number"] += 1  # the ego's is 0
        self._warm = vehicles, self._driven(cars)
        return _centres(self._warm[1])

    def staying(self) -> Centres:
        """Centres of the vehicles that will be there in the next step."""
        return _centres(self._staying())

    def expect(self, spawn: Spawn) -> Scenario:
        """Let a vehicle in at the start of the next step; returns the scenario with it."""
        assert self._scenario is not None
        scenario = self._scenario
        self._scenario = replace(scenario, spawns=(*scenario.spawns, spawn))
        arrival = tables.cars_of(scenario.road, [spawn.vehicle])
        arrival["number"] = len(self._everybody)
        self._spawns = {**self._spawns, spawn.step: (len(self._everybody),)}
        self._everybody = tables.joined(self._everybody, arrival)
        self._ids = [*self._ids, spawn.vehicle.id]
        return self._scenario

    def clone(self) -> Replica:
        """See `Simulator.clone`."""
        return copy.deepcopy(self)

    def imagine(self, scenario: Scenario) -> None:
        """See `Simulator.imagine`; drivers go on with the parameters that they have in this scenario."""
        self._read(scenario)
        self._cars[tables.PARAMETERS] = self._everybody[tables.PARAMETERS][self._cars["number"]]

    def close(self) -> None:
        """Forget the episode."""
        self._scenario = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Replica:
        """A copy for planners: it has cars of its own, and shares what never changes."""
        twin = copy.copy(self)
        if self._scenario is not None:
            twin._cars = tables.chosen(self._cars, slice(None))
        return twin

    # -- parts ---------------------------------------------------------------------------------------------

    def _prepare(self, road: Road, frequency: int) -> None:
        """Lanes and rules of a road."""
        connected = (
            self.connected if self.variant == "stock" else road.name in JOINED and self.variant != "v0"
        )
        self._lanes = tables.lanes_of(road, connected)
        self._seen_lanes = self._lanes.table if self.variant == "stock" else self._lanes.exact
        self._rules = Rules(
            along_path=connected and self.variant == "path",
            is_two_way=road.name == "two-way",
            # highway-env's expression: 7 at 15 Hz
            regulation_interval=int(1 / (1 / frequency) / 2) if road.name == "intersection" else 0,
            dt=1.0 / frequency,
            ego_contacts=self.ego_contacts,
        )

    def _read(self, scenario: Scenario) -> None:
        """All vehicles of a scenario as their lives start, those that come later as well, and its risk events."""
        self._scenario = scenario
        specs = [*scenario.specs, *(spawn.vehicle for spawn in scenario.spawns)]
        numbers = {spec.id: number for number, spec in enumerate(specs)}
        self._ids, self._everybody = list(numbers), tables.cars_of(scenario.road, specs)
        if self.is_linear:
            for name, driver in linear_drivers(scenario).items():
                tables.drive_linearly(self._everybody[numbers[name]], driver)
        self._events = tables.events_of(scenario.events, numbers)

    def _with_ego(self, placed: tables.Records) -> tables.Records:
        """``IntersectionEnv._make_vehicles``: traffic drives before the ego is placed, at least 20 m from anybody."""
        assert self._scenario is not None
        warm, self._warm = self._warm, None
        is_driven = warm is not None and warm[0] is self._scenario.vehicles
        cars = warm[1] if warm and is_driven else self._driven(tables.chosen(placed, slice(1, None)))
        cars = self._with_spawns(cars, 0)
        ego = placed[0]
        far = np.hypot(cars["x"] - ego["x"], cars["y"] - ego["y"]) >= EGO_DISTANCE
        return tables.joined(placed[:1], tables.chosen(cars, far))

    def _driven(self, cars: tables.Records) -> tables.Records:
        kernels.warm_up(self._lanes.table, cars, self._rules, self._warmed_up)
        return cars

    def _staying(self) -> tables.Records:
        """The cars that do not leave before the next step."""
        stays = kernels.staying(self._lanes.table, self._cars)
        return self._cars if stays.all() else tables.chosen(self._cars, stays)

    def _let_out_and_in(self) -> None:
        """Vehicles leave, and the spawns of this step come."""
        cars = self._with_spawns(self._staying(), self._policy_steps)
        if cars is not self._cars:
            self._cars = cars
            self._name_cars()

    def _with_spawns(self, cars: tables.Records, step: int) -> tables.Records:
        """The cars and those of the spawns of this policy step that have no other within 15 m."""
        for number in self._spawns.get(step, ()):
            fresh = self._everybody[number : number + 1]
            if kernels.is_free(cars, fresh["x"].item(), fresh["y"].item(), SPAWN_DISTANCE):
                cars = tables.joined(cars, fresh)
        return cars

    def _name_cars(self) -> None:
        self._present = tuple(self._ids[number] for number in self._cars["number"].tolist())

    def _steer_ego_for(self, lane: LaneIndex) -> None:
        """Set the ego's target lane; on the next road of its route, that road begins the rest of the route."""
        ego, number = self._cars[0], self._lanes.numbers[lane]
        if number == ego["target"]:
            return
        road = self._lanes.table["road"][number]
        legs = np.flatnonzero(ego["route"] == road)
        legs = legs[legs > ego["leg"]]
        if len(legs) and ego["route"][ego["leg"]] != road:
            ego["leg"], ego["planned"] = legs[0], tables.NONE
        ego["target"] = number

    def _scene(self, frame: Any, steps: int | None = None) -> Scene:
        """The scene of a frame of a trace, shape (6, n); `steps`: sub-steps since the start, if not all of them."""
        assert self._scenario is not None
        time = (self._steps if steps is None else steps) / self._scenario.simulation_frequency
        return Scene(
            ids=self._present,
            x=frame[X],
            y=frame[Y],
            speed=frame[SPEED],
            heading=frame[HEADING],
            crashed=frame[CRASHED] > 0.0,
            time=round(time, 6),
            in_event=frozenset(compress(self._present, frame[IN_EVENT])) if len(self._events) else NOBODY,
        )


@lru_cache(maxsize=1)
def _load() -> None:
    """Load all kernels, or compile them, by a call of each that drives nobody anywhere; once in a process."""
    lanes, rules = tables.lanes_of(highway(), False).table, Rules(False, False, 0, 0.1)
    cars, events, frames = np.zeros(1, tables.CAR), np.empty(0, tables.EVENT), np.empty((0, len(FRAME), 1))
    with announced(kernels.policy_step):
        kernels.warm_up(lanes, cars, rules, 0)
        kernels.staying(lanes, cars)
        kernels.is_free(cars, 0.0, 0.0, 0.0)
        kernels.policy_step(lanes, cars, events, 0, rules, 0, 0, 0, 0, frames)
        sight.ego_place(lanes, cars)
        sight.look(lanes, cars, sight.eyes_of(Kinematics({}, 1)), np.empty((5, 5), np.float32))


def _centres(cars: tables.Records) -> Centres:
    return list(zip(cars["x"].tolist(), cars["y"].tolist(), strict=True))


def _record(scene: Scene) -> CrashRecord:
    """The record of the ego's crash: highway-env does not say with whom, so it is the nearest wreck."""

    def gap(row: int) -> float:
        return separation(state_of(scene, 0), state_of(scene, row))

    wrecks = (np.flatnonzero(scene.crashed[1:]) + 1).tolist() or range(1, len(scene))
    return crash_record(scene, min(wrecks, key=gap), "highway-env")
