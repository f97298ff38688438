"""Where the dose acts while an episode runs: the risk events of a scenario as commands to SUMO's vehicles.

A cut-in is a lane change that SUMO executes without asking its lane-change model. All other kinds command a vehicle in
every sub-step in which they do not pause (`EventKind`). Afterwards the vehicle is SUMO's again.
"""

from __future__ import annotations

from bisect import insort
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

from sumo_env.contacts.rectangles import CAR, LENGTH, State
from sumo_env.networks.mapping import Network
from sumo_env.networks.roads import LaneIndex
from sumo_env.scene import Scene, is_obstacle
from sumo_env.sumo.session import ALL_CHECKS_OFF, HARD_BRAKING, Session
from sumo_env.sumo.tilted import Tilted
from sumo_env.sumo.vehicle import IN_SUMO, Vehicle
from sumo_env.traffic.risk import (
    HALF_CORRIDOR,
    LOOKED_AT,
    SWERVE_TIME,
    EventKind,
    RiskEvent,
    free_way,
    has_room,
)
from sumo_env.traffic.scenario import Scenario

CUT_IN_TIME = 1.3  # [s] until SUMO's lane-change model decides again, a little longer than the change takes
EARLY = 1e-9  # [s] rounding of sums of steps
SQUARE = 50.0  # [m] side of the squares by which vehicles that are near are found


def deviate(session: Session, vehicle: Vehicle, factors: Mapping[str, float]) -> None:
    """Multiply the parameters of a vehicle's own type by the factors of a risky driver (`drivers.deviation`)."""
    of, name = session.vehicle, vehicle.name
    for parameter, keys in IN_SUMO.items():
        factor = factors.get(parameter, 1.0)
        for key in keys if factor != 1.0 else ():  # each setter copies the vehicle's type
            getattr(of, f"set{key}")(name, factor * getattr(of, f"get{key}")(name))
    for key, factor in (("lcAssertive", factors["assertive"]), ("lcSpeedGain", factors["speed_gain"])):
        parameter = f"laneChangeModel.{key}"
        with suppress(ValueError, *session.errors):  # there are models of lane changes without it
            present = float(of.getParameter(name, parameter))
            of.setParameter(name, parameter, f"{factor * present:.6g}")
    if not factors["gives_way"]:
        vehicle.ignore_rules()


class Moment(NamedTuple):
    """What a kind of event knows before a sub-step.

    Attributes:
        event: that runs.
        vehicle: on which it acts, with what may be commanded.
        sumo: libsumo's functions of vehicles.
        dt: length of the sub-step [s].
        look: where all vehicles are, by their ids: x, y [m], speed [m/s], heading [rad].
        near: likewise those within so many metres of the vehicle, itself and some further ones included.
    """

    event: RiskEvent
    vehicle: Vehicle
    sumo: Any
    dt: float
    look: Callable[[], Mapping[str, State]]
    near: Callable[[float], Mapping[str, State]]


class Push(EventKind):
    """Sudden braking, which keeps SUMO's car following, or a surge, which switches it off."""

    def pauses(self, at: Moment) -> bool:
        """A surge pauses while somebody is near straight ahead; a brake never does."""
        if at.event.kind == "brake":
            return False
        states = at.near(at.event.way + HALF_CORRIDOR)
        return not free_way(states[at.event.vehicle], states.values(), at.event.way)

    def command(self, at: Moment) -> None:
        """Change the speed."""
        at.vehicle.hold_speed(HARD_BRAKING if at.event.kind == "brake" else ALL_CHECKS_OFF)
        at.vehicle.drive(max(at.sumo.getSpeed(at.event.vehicle) + at.event.accel * at.dt, 0.0))

    def give_back(self, at: Moment) -> None:
        """The speed is SUMO's."""
        at.vehicle.free_speed()


PUSH = Push()


@dataclass
class Running:
    """An event that is running, or pauses."""

    event: RiskEvent
    kind: EventKind
    end: float  # [s]
    acts: bool = False


class Events:
    """The risk events of one episode among the vehicles on the road, which change. Who has crashed has none."""

    def __init__(
        self, session: Session, scenario: Scenario, network: Network, road: Mapping[str, Vehicle]
    ) -> None:
        self._coming = list(reversed(scenario.events))
        self._tilted = Tilted(scenario.tilt) if scenario.tilt else None
        if self._tilted:
            self._tilted.plan((name for name, _ in scenario.lifetimes), scenario.events)
        self._session, self._network, self._road = session, network, road
        self._asks_for_markings = scenario.traffic is not None
        self._cut_ins: dict[str, float] = {}  # vehicle -> end of its forced lane change [s]
        self._running: dict[str, Running] = {}  # what commands a vehicle, but for cut-ins
        self._states: dict[str, State] = {}  # of all vehicles in this sub-step, once somebody has looked
        self._squares: dict[tuple[float, float], list[str]] = {}  # of the plane, with the vehicles there
        self._longest = LENGTH  # [m] of a vehicle that is there, at least of a car

    def act(self, time: float, dt: float) -> None:
        """Begin, continue and end events before the sub-step from `time` to `time` + `dt` [s]."""
        if not (self._cut_ins or self._running or (self._coming and self._coming[-1].time <= time + EARLY)):
            return
        self._states = {}
        while self._coming and self._coming[-1].time <= time + EARLY:
            event = self._coming.pop()
            if self._may_act(event.vehicle) and self._comes(event):
                if event.kind == "cut-in":
                    self._cut_in(event, time)
                else:
                    self._start(event, time, dt)
        for commanded in (self._cut_ins, self._running):
            for name in [name for name in commanded if not self._may_act(name)]:
                del commanded[name]
        for name in [name for name, end in self._cut_ins.items() if time >= end - EARLY]:
            del self._cut_ins[name]
            self._end_cut_in(name)
        for name, running in list(self._running.items()):
            self._go_on(name, running, time, dt)

    def _comes(self, event: RiskEvent) -> bool:
        """Whether an event that is due begins: not a further one of a vehicle far away."""
        return self._tilted.comes(event) if self._tilted else not event.is_further

    def counted(self, scene: Scene) -> Scene:
        """The scene after a policy step, or at the start, with the events near learning cars if they are counted."""
        return replace(scene, near_events=self._tilted.count(scene)) if self._tilted else scene

    def _may_act(self, name: str) -> bool:
        """Whether a vehicle is on the road, and SUMO's but for events."""
        vehicle = self._road.get(name)
        if vehicle is None or vehicle.crashed:
            return False
        return not (vehicle.is_learning or is_obstacle(name))

    def _look(self) -> dict[str, State]:
        """Where all vehicles are."""
        if not self._states:
            self._states, self._squares = self._session.read(self._road), defaultdict(list)
            self._longest = max((LENGTH, *(length for length, _ in self._session.sizes.values())))
            for name, (x, y, _, _) in self._states.items():
                self._squares[x // SQUARE, y // SQUARE].append(name)
        return self._states

    def _near(self, x: float, y: float, reach: float) -> dict[str, State]:
        """Where the vehicles within `reach` [m] of a place are, and some further ones."""
        states, squares = self._look(), self._squares
        sides = [range(int((at - reach) // SQUARE), int((at + reach) // SQUARE) + 1) for at in (x, y)]
        return {
            name: states[name] for pair in product(*sides) for name in squares.get((pair[0], pair[1]), ())
        }

    def plan(self, vehicle: str, events: Sequence[RiskEvent]) -> None:
        """A vehicle has come, with these events."""
        self._add(events)
        if self._tilted:
            self._tilted.plan((vehicle,), events)

    def _add(self, events: Sequence[RiskEvent]) -> None:
        for event in events:
            insort(self._coming, event, key=lambda one: -one.time)

    def replace(self, events: Sequence[RiskEvent], now: float) -> None:
        """Go on with these events in place of those after `now` [s], none of them more often near learning cars."""
        self._coming = [event for event in self._coming if event.time <= now and self._comes(event)]
        self._tilted = None
        self._add([event for event in events if event.time > now])

    @property
    def acting(self) -> frozenset[str]:
        """Names of the vehicles that an event commands now."""
        acting = (name for name, running in self._running.items() if running.acts)
        return frozenset(name for name in (*self._cut_ins, *acting) if self._may_act(name))

    # -- cut-ins -------------------------------------------------------------------------------------------

    def _cut_in(self, event: RiskEvent, time: float) -> None:
        """Change to a neighbouring lane at once, where there is one with room."""
        name, session = event.vehicle, self._session
        lane = session.vehicle.getLaneID(name)
        if lane not in self._network.indices or lane.startswith(":") or session.changes_lane(name):
            return
        road = self._network.road
        oncoming = road.oncoming  # then the only lane beside is that of oncoming traffic
        for side in (-1,) if oncoming else (event.direction, -event.direction):
            beside = road.beside(self._network.indices[lane], side)
            if beside is None or self._leads_off(name, beside) or not self._has_room(name, beside):
                continue
            if self._asks_for_markings and not self._is_open(name, lane, beside):
                continue
            self._road[name].hold_lanes()
            if oncoming:
                session.vehicle.changeLaneRelative(name, 1, 0.0)
            else:
                limits = {road.lane(index).speed_limit for index in (self._network.indices[lane], beside)}
                if len(limits) > 1 and not self._asks_for_markings:  # a faster lane makes nobody faster
                    session.vehicle.setMaxSpeed(name, session.vehicle.getAllowedSpeed(name))
                session.vehicle.changeLane(name, self._network.sumo_index(beside), 0.0)
            self._cut_ins[name] = time + (SWERVE_TIME if oncoming else CUT_IN_TIME)
            return

    def _is_open(self, name: str, lane: str, beside: LaneIndex) -> bool:
        """Whether markings and classes let a vehicle change to the lane beside, without which SUMO does not."""
        there = self._network.lanes[beside].id
        return self._session.may_change(lane, there, self._session.vehicle.getVehicleClass(name))

    def _leads_off(self, name: str, beside: LaneIndex) -> bool:
        """Whether the lane beside leads along another route than the vehicle's.

        With SUMO's own files that counts where lane changes take their time, which SUMO breaks down over.
        """
        session, there = self._session, self._network.lanes[beside].id
        if self._asks_for_markings:
            ways = session.lanes_ahead(name) if session.lane_change_duration > 0.0 else []
            return any(lane == there and not leads for lane, _, leads in ways)
        way = session.vehicle.getRouteID(name)
        return way in self._network.routes and way != self._network.leading_on(way, there)

    def _has_room(self, name: str, lane: LaneIndex) -> bool:
        x, y, speed, _ = self._look()[name]
        geometry = self._network.road.lane(lane)
        s, _ = geometry.local_coordinates(x, y)
        there = *geometry.position(s, 0.0), speed, geometry.heading_at(s)
        states = self._near(*there[:2], LOOKED_AT + self._longest)
        states.pop(name, None)
        # what is smaller than a car is given the room of one
        halves = [
            (max(length, CAR[0]), max(width, CAR[1]))
            for length, width in self._session.halves((name, *states))
        ]
        return has_room(there, list(states.values()), halves)

    def _end_cut_in(self, name: str) -> None:
        if self._network.road.oncoming:
            self._session.vehicle.changeLaneRelative(name, -1, 0.0)
        self._road[name].free_lanes()

    # -- all other kinds -----------------------------------------------------------------------------------

    def _at(self, event: RiskEvent, dt: float) -> Moment:
        vehicle = self._road[event.vehicle]

        def near(reach: float) -> Mapping[str, State]:
            return self._near(*self._look()[vehicle.name][:2], reach)

        return Moment(event, vehicle, self._session.vehicle, dt, self._look, near)

    def _start(self, event: RiskEvent, time: float, dt: float) -> None:
        """An event begins; one of another kind on this vehicle ends."""
        kind = event.kind if isinstance(event.kind, EventKind) else PUSH
        before = self._running.get(event.vehicle)
        acts = before is not None and before.acts
        if before is not None and acts and before.kind != kind:
            before.kind.give_back(self._at(before.event, dt))
            acts = False
        self._running[event.vehicle] = Running(event, kind, time + event.duration, acts)

    def _go_on(self, name: str, running: Running, time: float, dt: float) -> None:
        """Command a vehicle for one sub-step, or give it back to SUMO."""
        at, acted = self._at(running.event, dt), running.acts
        ended = time >= running.end - EARLY
        running.acts = not ended and not running.kind.pauses(at)
        if ended:
            del self._running[name]
        if running.acts:
            running.kind.command(at)
        elif acted:
            running.kind.give_back(at)
