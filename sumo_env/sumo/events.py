"""Where the dose acts while an episode runs: the risk events of a scenario as commands to SUMO's vehicles.

A cut-in is a lane change that SUMO executes without asking its lane-change model; braking and surges are commanded
speeds, where braking keeps SUMO's car following and a surge switches it off. Afterwards the vehicle is SUMO's again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from sumo_env.contacts.rectangles import CAR, State
from sumo_env.networks.mapping import Network
from sumo_env.networks.roads import LaneIndex
from sumo_env.sumo.session import ALL_CHECKS_OFF, HARD_BRAKING, Session
from sumo_env.sumo.vehicle import Vehicle
from sumo_env.traffic.risk import SWERVE_TIME, RiskEvent, free_way, has_room
from sumo_env.traffic.scenario import Scenario

CUT_IN_TIME = 1.3  # [s] until SUMO's lane-change model decides again, a little longer than the change takes
EARLY = 1e-9  # [s] rounding of sums of steps


# The parameters of drivers in SUMO's words.
IN_SUMO = {"accel": ("Accel",), "emergency_decel": ("EmergencyDecel",), "decel": ("ApparentDecel", "Decel")}
IN_SUMO |= {"tau": ("Tau",), "min_gap": ("MinGap",)}


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


@dataclass
class Push:
    """A brake or a surge that is running, or pauses."""

    event: RiskEvent
    end: float  # [s]


class Events:
    """The risk events of one episode among the vehicles on the road, which change. Who has crashed has none."""

    def __init__(
        self, session: Session, scenario: Scenario, network: Network, road: Mapping[str, Vehicle]
    ) -> None:
        self._coming, self._count = list(reversed(scenario.events)), len(scenario.events)
        self._session, self._network, self._road = session, network, road
        self._asks_for_markings = scenario.traffic is not None
        self._cut_ins: dict[str, float] = {}  # vehicle -> end of its forced lane change [s]
        self._pushes: dict[str, Push] = {}
        self._states: dict[str, State] = {}  # of all vehicles in this sub-step, once somebody has looked

    def act(self, time: float, dt: float) -> None:
        """Begin, continue and end events before the sub-step from `time` to `time` + `dt` [s]."""
        if not (self._cut_ins or self._pushes or (self._coming and self._coming[-1].time <= time + EARLY)):
            return
        self._states = {}
        while self._coming and self._coming[-1].time <= time + EARLY:
            event = self._coming.pop()
            if self._may_act(event.vehicle):
                if event.kind == "cut-in":
                    self._cut_in(event, time)
                else:
                    self._pushes[event.vehicle] = Push(event, time + event.duration)
        for running in (self._cut_ins, self._pushes):
            for name in [name for name in running if not self._may_act(name)]:
                del running[name]
        for name in [name for name, end in self._cut_ins.items() if time >= end - EARLY]:
            del self._cut_ins[name]
            self._end_cut_in(name)
        for name, push in list(self._pushes.items()):
            self._push(name, push, time, dt)

    def _may_act(self, name: str) -> bool:
        """Whether a vehicle is on the road, and SUMO's but for events."""
        vehicle = self._road.get(name)
        return vehicle is not None and not vehicle.crashed and not vehicle.is_learning

    def _look(self) -> dict[str, State]:
        """Where all vehicles are."""
        self._states = self._states or self._session.read(self._road)
        return self._states

    def imagine(self, events: Sequence[RiskEvent]) -> None:
        """Go on with these events; those that have begun are the same."""
        begun = self._count - len(self._coming)
        self._coming, self._count = list(reversed(events[begun:])), len(events)

    def add(self, events: Sequence[RiskEvent]) -> None:
        """Events of a vehicle that has come."""
        self._coming = sorted((*self._coming, *events), key=lambda event: event.time, reverse=True)

    def replace(self, events: Sequence[RiskEvent]) -> None:
        """Go on with these events in place of those that have not begun."""
        self._coming = []
        self.add(events)

    @property
    def acting(self) -> frozenset[str]:
        """Names of the vehicles that an event commands now."""
        pushed = (name for name in self._pushes if name in self._road and self._road[name].has_speed)
        return frozenset(name for name in (*self._cut_ins, *pushed) if self._may_act(name))

    # -- cut-ins -------------------------------------------------------------------------------------------

    def _cut_in(self, event: RiskEvent, time: float) -> None:
        """Change to a neighbouring lane at once, where there is one with room."""
        name, session = event.vehicle, self._session
        lane = session.vehicle.getLaneID(name)
        if lane not in self._network.indices or lane.startswith(":") or session.changes_lane(name):
            return
        start, end, place = self._network.indices[lane]
        count = self._network.road.count(start, end)
        oncoming = self._network.road.oncoming  # then the only lane beside is that of oncoming traffic
        targets = (0,) if oncoming else (place + event.direction, place - event.direction)
        for target in targets:
            beside = start, end, target
            if target == place or not 0 <= target < count or not self._has_room(name, beside):
                continue
            if self._asks_for_markings and not self._is_open(name, lane, beside):
                continue
            self._road[name].hold_lanes()
            if oncoming:
                session.vehicle.changeLaneRelative(name, 1, 0.0)
            else:
                session.vehicle.changeLane(name, self._network.sumo_index(beside), 0.0)
            self._cut_ins[name] = time + (SWERVE_TIME if oncoming else CUT_IN_TIME)
            return

    def _is_open(self, name: str, lane: str, beside: LaneIndex) -> bool:
        """Whether markings and classes let a vehicle change to the lane beside, without which SUMO does not."""
        there = self._network.lanes[beside].id
        return self._session.may_change(lane, there, self._session.vehicle.getVehicleClass(name))

    def _has_room(self, name: str, lane: LaneIndex) -> bool:
        states = self._look().copy()
        x, y, speed, _ = states.pop(name)
        geometry = self._network.road.lane(lane)
        s, _ = geometry.local_coordinates(x, y)
        there = *geometry.position(s, 0.0), speed, geometry.heading_at(s)
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

    # -- braking and surges --------------------------------------------------------------------------------

    def _push(self, name: str, push: Push, time: float, dt: float) -> None:
        """Command the speed of a braking or surging vehicle for one sub-step, or give it back to SUMO."""
        vehicle, event = self._road[name], push.event
        ended = time >= push.end - EARLY
        if ended:
            del self._pushes[name]
        if ended or not self._may_push(event):
            vehicle.free_speed()
            return
        vehicle.hold_speed(HARD_BRAKING if event.kind == "brake" else ALL_CHECKS_OFF)
        vehicle.drive(max(self._session.vehicle.getSpeed(name) + event.accel * dt, 0.0))

    def _may_push(self, event: RiskEvent) -> bool:
        """A surge pauses while somebody is near straight ahead; a brake never does."""
        if event.kind == "brake":
            return True
        states = self._look()
        return free_way(states[event.vehicle], states.values(), event.way)
