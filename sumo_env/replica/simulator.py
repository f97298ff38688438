"""`Replica`: highway-env's physics without SUMO, as a `sumo_env.simulator.Simulator`."""

import copy
from dataclasses import replace
from functools import lru_cache
from itertools import compress
from math import hypot, inf
from typing import Any

import numpy as np

from sumo_env.config import ConfigError, one_of
from sumo_env.contacts.crash import CrashRecord, crash_record
from sumo_env.contacts.measures import TTC_RADIUS, ego_ttc
from sumo_env.contacts.rectangles import separation, state_of
from sumo_env.networks.roads import LaneIndex, Road, highway
from sumo_env.replica import observation, tables
from sumo_env.replica import step as kernels
from sumo_env.replica.batch import Start, begun, copied, expecting, no_episodes, remaining
from sumo_env.replica.compiled import compile_notice
from sumo_env.replica.draws import Centres
from sumo_env.replica.linear import linear_drivers
from sumo_env.replica.step import CRASHED, HEADING, IN_EVENT, SPEED, Rules, X, Y
from sumo_env.scene import MAX_SPEED, NO_LIGHT, OBSTACLE_SIZE, VEHICLE_LENGTH, Scene, is_obstacle
from sumo_env.simulator import LANE_ENDED, Command, Commands, EgoStep, SteeringCommand, Step
from sumo_env.spaces.observation import Kinematics, TableForm
from sumo_env.traffic.scenario import EGO_DISTANCE, SPAWN_DISTANCE, Scenario, Spawn, VehicleSpec

VARIANTS = ("stock", "path", "connected", "v0")
NOBODY: frozenset[str] = frozenset()

FRAME = ("x", "y", "speed", "heading", "crashed", "in_event")  # the rows of a frame of a trace


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

    _scenario: Scenario
    _is_begun = False  # whether there is an episode

    def __init__(self, variant: str = "path", is_linear: bool = False, ego_contacts: bool = False) -> None:
        self.variant = one_of("variant", variant, VARIANTS)
        self.is_linear, self.ego_contacts = is_linear, ego_contacts
        _load()
        self.connected = False  # whether drivers of the variant "stock" look onto the next lanes
        self._crashes: dict[str, CrashRecord] = {}  # of the learning cars
        self._before: int | None = None  # see `seen_by`
        self._ids: list[str] = []
        self._warm: tuple[tuple[VehicleSpec, ...], tables.Records] | None = None

    def reset(self, scenario: Scenario) -> Scene:
        """See `Simulator.reset`."""
        self._batch, self._crashes = begun(no_episodes(1), 0, self.load(scenario)), {}
        self._is_begun = True
        self._look()
        return self._scene(np.array([self._cars[name] for name in FRAME], float), 0)

    def load(self, scenario: Scenario) -> Start:
        """Place a scenario and drive its warm-up."""
        self._prepare(scenario.road, scenario.simulation_frequency)
        warmed_up = round(scenario.warm_up * scenario.simulation_frequency)
        substeps = scenario.simulation_frequency // scenario.policy_frequency
        rules = self._rules._replace(substeps=substeps, warmed_up=warmed_up)
        everybody, events = self._read(scenario)
        present = len(scenario.specs)
        cars = everybody[:present]
        everybody["comes_after"][present:] = [spawn.step for spawn in scenario.spawns]
        at_once = sum(spawn.step == 0 for spawn in scenario.spawns)
        if warmed_up:
            cars = self._with_ego(cars, everybody[present : present + at_once], warmed_up)
        present += at_once
        first_arrival = present if self.variant == "stock" and warmed_up else 0
        self.start = Start(rules, cars, everybody[present:], first_arrival, events)
        return self.start

    def step(self, commands: Commands, trace: bool = False) -> Step:
        """See `Simulator.step`."""
        if not self._is_begun:
            raise RuntimeError("call reset() before step()")
        batch, rules = self._batch, self.start.rules
        for name, command in commands.items():
            if isinstance(command, SteeringCommand):
                rules = steered(rules, command.speed_range, command.dynamical)
            self._obey(batch.cars[0, self._egos[name]], command)
        speeds = {name: batch.cars[0, row]["speed"].item() for name, row in self._egos.items() if row}
        frames = np.empty((rules.substeps, len(FRAME), batch.cars.shape[1]))
        met = kernels.policy_step(self.lanes.table, rules, batch, 0, frames)
        self._look()
        end = self._steps * rules.substeps
        start, frames = end - rules.substeps, frames[:, :, : len(self._cars)]
        egos = {}
        for name, row in self._egos.items():
            crash, min_ttc, distance = _met(frames, row, speeds[name], rules.dt) if row else met
            if crash >= 0 and name not in self._crashes:
                self._crashes[name] = _record(self._scene(frames[crash], start + crash + 1).seen_by(name))
            target = self.lanes.names[self._cars[row]["target"]]
            ended = LANE_ENDED if self._has_ended(frames[:, :, row]) else ""
            egos[name] = EgoStep(target, self._crashes.get(name), min_ttc, distance, ended)
        return Step(
            scene=self._scene(frames[-1], end),
            egos=egos,
            trace=tuple(self._scene(frame, start + k + 1) for k, frame in enumerate(frames)) if trace else (),
        )

    def _has_ended(self, way: Any) -> bool:
        """Whether a car has driven over the end of a lane that ends before the road does; way: its part of a trace.

        highway-env's cars steer for the nearest lane from half a vehicle before the end on; SUMO's front is there then.
        """
        road, dt = self._scenario.road, self._rules.dt
        for lane in map(road.lane, road.dead_ends):
            for x, y, speed in way[:, [X, Y, SPEED]].tolist():
                s, lateral = lane.local_coordinates(x, y)
                beyond = s - (lane.length - VEHICLE_LENGTH / 2.0)
                if 0.0 <= beyond <= speed * dt and abs(lateral) <= lane.width / 2.0:
                    return True
        return False

    def _obey(self, ego: Any, command: Command | None) -> None:
        """Take over the command of a policy step."""
        if isinstance(command, SteeringCommand):
            ego["acceleration"], ego["steering"], ego["target_speed"] = *command[:2], 0.0  # see `step.hold`
        elif command is None or command.target_speed is None or command.target_lane is None:
            raise ValueError("a learning car of the replica needs a target speed and a target lane")
        else:
            ego["target_speed"] = command.target_speed
            self._steer_ego_for(ego, command.target_lane)

    def seen_by(self, name: str) -> "Replica":
        """The present state in which this learning car is the ego, for `ego_place`, `before_ego` and `table`."""
        first = self.before_ego()
        order = [*range(1, first + 1), 0, *range(first + 1, len(self._cars))]  # highway-env's list
        twin, row = copy.copy(self), self._egos[name]
        twin._before = order.index(row)
        order.remove(row)
        twin._cars = tables.chosen(self._cars, [row, *order])
        return twin

    def ego_place(self) -> tuple[LaneIndex, float, float, bool]:
        """The ego's lane, its coordinates on it (s and lat) [m], and whether it is on the road."""
        lane, s, lateral, is_on_road = observation.ego_place(self.seen_lanes, self._cars)
        return self.lanes.names[lane], s, lateral, is_on_road

    def before_ego(self) -> int:
        """How many of the others come before the ego in highway-env's list of vehicles."""
        if self._before is not None:
            return self._before
        others = self._cars[1:]
        return int(((others["number"] < self.start.first_arrival) & ~others["is_ego"]).sum())

    def table(self, form: TableForm) -> np.ndarray:
        """The Kinematics observation."""
        table = np.empty((form.rows, len(form.features)), np.float32)
        observation.observe(self.seen_lanes, self._cars, form, table)
        return table

    def warm_up(self, road: Road, vehicles: tuple[VehicleSpec, ...], time: float, frequency: int) -> Centres:
        """Centres of vehicles after they have driven for a time [s] without an ego.

        `reset` with a scenario of these vehicles takes over what was driven.
        """
        self._prepare(road, frequency)
        cars = tables.cars_of(road, vehicles)
        cars["number"] += 1  # the ego's is 0
        self._warm = vehicles, self._driven(cars, round(time * frequency))
        return list(zip(cars["x"].tolist(), cars["y"].tolist(), strict=True))

    def staying(self) -> Centres:
        """Centres of the vehicles that will be there in the next step."""
        return remaining(self._batch, 0, self.lanes.table)

    def expect(self, spawn: Spawn) -> Scenario:
        """Let a vehicle in at the start of the next step; returns the scenario with it."""
        arrival = tables.cars_of(self._scenario.road, [spawn.vehicle])
        arrival["number"] = len(self._ids)
        self._batch = expecting(self._batch, 0, arrival)
        self._ids = [*self._ids, spawn.vehicle.id]
        self._scenario = replace(self._scenario, spawns=(*self._scenario.spawns, spawn))
        return self._scenario

    def imagine(self, scenario: Scenario) -> None:
        """See `Simulator.imagine`; drivers go on with the parameters that they have in this scenario."""
        everybody, events = self._read(scenario)
        for cars in (self._batch.cars, self._batch.arrivals):
            cars[tables.PARAMETERS] = everybody[tables.PARAMETERS][cars["number"]]
        self._batch.episodes["events"] = len(events)
        self._batch = self._batch._replace(events=events[None])

    def close(self) -> None:
        """Forget the episode."""
        self._is_begun = False

    def __deepcopy__(self, memo: dict[int, Any]) -> "Replica":
        """A copy for planners: it has cars of its own, and shares what never changes."""
        twin = copy.copy(self)
        if self._is_begun:
            twin._batch, twin._crashes = copied(self._batch, [0]), self._crashes.copy()
            twin._look()
        return twin

    # -- parts ---------------------------------------------------------------------------------------------

    def _prepare(self, road: Road, frequency: int) -> None:
        """Lanes and rules of a road."""
        connected = self.connected if self.variant == "stock" else road.joined and self.variant != "v0"
        self.lanes = tables.lanes_of(road, connected)
        self.seen_lanes = self.lanes.table if self.variant == "stock" else self.lanes.exact
        self._rules = Rules(
            along_path=connected and self.variant == "path",
            is_two_way=road.oncoming,
            # highway-env's expression: 7 at 15 Hz
            regulation_interval=int(1 / (1 / frequency) / 2) if road.regulated else 0,
            dt=1.0 / frequency,
            ego_contacts=self.ego_contacts,
        )

    def _read(self, scenario: Scenario) -> tuple[tables.Records, tables.Records]:
        """All vehicles of a scenario as their lives start, those that come later as well, and its risk events."""
        self._scenario = scenario
        specs = scenario.everybody
        for spec in specs:
            if spec.driver.attributes and not is_obstacle(spec.id):
                raise ConfigError(f"the replica has no attributes of SUMO's vehicle types as {spec.id!r} has")
        numbers = {spec.id: number for number, spec in enumerate(specs)}
        self._ids, everybody = list(numbers), tables.cars_of(scenario.road, specs)
        for name in scenario.further:
            everybody["is_ego"][numbers[name]] = True
        if self.is_linear:
            for name, driver in linear_drivers(scenario).items():
                tables.drive_linearly(everybody[numbers[name]], driver)
        return everybody, tables.events_of(scenario.events, numbers)

    def _with_ego(self, placed: tables.Records, late: tables.Records, warmed_up: int) -> tables.Records:
        """``IntersectionEnv._make_vehicles``: traffic drives before the ego is placed, at least 20 m from anybody.

        Late cars come only then, where there is room.
        """
        warm, self._warm = self._warm, None
        if warm is not None and warm[0] is self._scenario.vehicles:
            cars = warm[1]
        else:
            cars = self._driven(tables.chosen(placed, ~placed["is_ego"]), warmed_up)
        for fresh in (late[k : k + 1] for k in range(len(late))):
            if kernels.is_free(cars, fresh["x"].item(), fresh["y"].item(), SPAWN_DISTANCE):
                cars = tables.joined(cars, fresh)
        egos = tables.chosen(placed, placed["is_ego"])
        for ego in egos:
            far = np.hypot(cars["x"] - ego["x"], cars["y"] - ego["y"]) >= EGO_DISTANCE
            cars = tables.chosen(cars, far)
        return tables.joined(tables.joined(egos[:1], cars), egos[1:])

    def _driven(self, cars: tables.Records, substeps: int) -> tables.Records:
        kernels.warm_up(self.lanes.table, cars, self._rules, substeps)
        return cars

    def _look(self) -> None:
        """Which cars are there now, and how many policy steps were driven."""
        episode = self._batch.episodes[0]
        self._steps, self._cars = int(episode["steps"]), self._batch.cars[0, : episode["cars"]]
        if not self._steps or self._rules.regulation_interval:  # cars come and go at the intersection alone
            present = [self._ids[number] for number in self._cars["number"].tolist()]
            rows = np.flatnonzero(self._cars["is_ego"]).tolist() if self._scenario.further else [0]
            self._egos = {present[row]: row for row in rows}
            self._order = None
            if len(rows) > 1:
                self._order = [*rows, *(row for row in range(len(present)) if row not in rows)]
                present = [present[row] for row in self._order]
            self._present = tuple(present)
            self._sizes = {name: OBSTACLE_SIZE for name in present if is_obstacle(name)}

    def _steer_ego_for(self, ego: Any, lane: LaneIndex) -> None:
        """Set the ego's target lane; on the next road of its route, that road begins the rest of the route."""
        number = self.lanes.numbers[lane]
        if number == ego["target"]:
            return
        road = self.lanes.table["road"][number]
        legs = np.flatnonzero(ego["route"] == road)
        legs = legs[legs > ego["leg"]]
        if len(legs) and ego["route"][ego["leg"]] != road:
            ego["leg"], ego["planned"] = legs[0], tables.NONE
        ego["target"] = number

    def _scene(self, frame: Any, steps: int) -> Scene:
        """The scene of a frame of a trace, shape (6, n), after these sub-steps since the start."""
        if self._order is not None:
            frame = frame[:, self._order]
        return Scene(
            ids=self._present,
            x=frame[X],
            y=frame[Y],
            speed=frame[SPEED],
            heading=frame[HEADING],
            crashed=frame[CRASHED] > 0.0,
            time=round(steps / self._scenario.simulation_frequency, 6),
            in_event=frozenset(compress(self._present, frame[IN_EVENT])) if self._scenario.events else NOBODY,
            sizes=self._sizes,
            cars=len(self._egos),
            further=dict.fromkeys(self._present[1 : len(self._egos)], (NO_LIGHT, None)),
        )


def steered(rules: Rules, speed_range: tuple[float, float] | None, dynamical: bool) -> Rules:
    """The rules for an ego that is steered, see `SteeringCommand`."""
    slowest, fastest = speed_range or (-MAX_SPEED, MAX_SPEED)
    return rules._replace(is_steered=True, is_dynamical=dynamical, slowest=slowest, fastest=fastest)


@lru_cache(maxsize=1)
def _load() -> None:
    """Load all kernels, or compile them, by a call of each that drives nobody anywhere; once in a process."""
    lanes, rules = tables.lanes_of(highway(), False).table, Rules(False, False, 0, 0.1)
    cars, frames = np.zeros(1, tables.CAR), np.empty((0, len(FRAME), 1))
    with compile_notice(kernels.policy_step):
        kernels.warm_up(lanes, cars, rules, 0)
        kernels.staying(lanes, cars)
        kernels.is_free(cars, 0.0, 0.0, 0.0)
        kernels.policy_step(lanes, rules, no_episodes(1), 0, frames)
        observation.ego_place(lanes, cars)
        observation.observe(lanes, cars, Kinematics({}, 1).form, np.empty((5, 5), np.float32))


def _met(frames: Any, row: int, speed: float, dt: float) -> tuple[int, float, float]:
    """What `step.policy_step` returns, of the learning car in another row of its trace.

    speed: before the step [m/s]; dt: length of a sub-step [s].
    """
    distance, least, crashes = 0.0, inf, np.flatnonzero(frames[:, CRASHED, row])
    for number, frame in enumerate(frames):
        distance += max(speed, 0.0) * dt
        speed = frame[SPEED, row].item()
        if not crashes.size or number < crashes[0]:
            states = [(x, y, v, heading) for x, y, v, heading in frame[: HEADING + 1].T.tolist()]
            ego = states.pop(row)
            near = [one for one in states if hypot(one[0] - ego[0], one[1] - ego[1]) <= TTC_RADIUS]
            least = min(least, ego_ttc(ego, near))
    return int(crashes[0]) if crashes.size else -1, least, distance


def _record(scene: Scene) -> CrashRecord:
    """The record of the ego's crash: highway-env does not say with whom, so it is the nearest wreck."""

    def gap(row: int) -> float:
        return separation(state_of(scene, 0), state_of(scene, row))

    wrecks = (np.flatnonzero(scene.crashed[1:]) + 1).tolist() or range(1, len(scene))
    return crash_record(scene, min(wrecks, key=gap), "highway-env")
