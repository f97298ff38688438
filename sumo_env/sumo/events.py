"""Where the dose acts while an episode runs: the risk events of a scenario as commands to SUMO's vehicles.

A cut-in is a lane change that SUMO executes without asking its lane-change model, as other kinds may command one. All
other kinds command a vehicle in every sub-step in which they do not pause (`EventKind`). Afterwards it is SUMO's again.
"""

from bisect import insort
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import inf
from typing import Any, NamedTuple

from sumo_env.contacts.rectangles import CAR, LENGTH, State
from sumo_env.networks.mapping import Network
from sumo_env.networks.roads import LaneIndex
from sumo_env.scene import Scene, is_obstacle
from sumo_env.sumo.session import ALL_CHECKS_OFF, RIGHT_OF_WAY, Session
from sumo_env.sumo.tilted import Tilted
from sumo_env.sumo.vehicle import Vehicle
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

CHANGE_TIME = 1.3  # [s] until SUMO's lane-change model decides again, a little longer than the change takes
DELAY = 2.0  # [s] that a cut-in waits until its vehicle may begin a change; then it does not come
PATIENCE = 10.0  # [s] that a vehicle waits for room to come back, before SUMO's lane-change model decides
YELLOW = 3.0  # [s] that a light is yellow before it is red, as netconvert makes them
# [s] While a speed is commanded, and after it, SUMO's EIDM may wish to stop at once, from any speed.
SETTLING = 1.0
UNLIMITED = 1000.0  # [m/s] a command that leaves the choice to SUMO, within the limits of its speed mode
CHANGE = "change"  # that commands lanes
EARLY = 1e-9  # [s] rounding of sums of steps
SQUARE = 50.0  # [m] side of the squares by which vehicles that are near are found


class Moment(NamedTuple):
    """What a kind of event knows before a sub-step.

    Attributes:
        event: that runs.
        vehicle: on which it acts, with what may be commanded.
        sumo: libsumo's functions of vehicles.
        dt: length of the sub-step [s].
        elapsed: since the event began [s], 0 in its first sub-step.
        look: where all vehicles are, by their ids: x, y [m], speed [m/s], heading [rad].
        near: likewise those within so many metres of the vehicle, itself and some further ones included.
        has_room: whether a change to the lane on a side (-1 left, +1 right) may begin now and leaves CUT_IN_GAP.
        change_lane: begins a change to the lane on a side, whoever is there, and holds the vehicle's lanes; with
            seconds, it comes back after these, as soon as there is room. False where no change may begin: there is no
            lane that leads on, the vehicle stands, its edge ends before, or a change is running.
    """

    event: RiskEvent
    vehicle: Vehicle
    sumo: Any
    dt: float
    look: Callable[[], Mapping[str, State]]
    near: Callable[[float], Mapping[str, State]]
    elapsed: float
    has_room: Callable[[int], bool]
    change_lane: Callable[..., bool]


def stops_ahead(at: Moment) -> bool:
    """Whether its vehicle has to brake now for the next traffic light, or where its lane does not lead on.

    There SUMO would stop it at once. A green light counts where it could neither stop nor pass any more if the light
    turned yellow now.
    """
    name, of = at.vehicle.name, at.sumo
    speed = of.getSpeed(name) + at.event.accel * at.dt
    way = at.vehicle.way_to_stop(speed)
    lane, place = of.getLaneID(name), of.getLanePosition(name)
    ends = (end - place for own, end, _, _, leads, _ in of.getBestLanes(name) if own == lane and not leads)
    lights = (far for _, _, far, state in of.getNextTLS(name) if state in "rRuyY" or far > speed * YELLOW)
    return any(distance < way for distance in (*ends, *lights))


@dataclass(frozen=True)
class Push(EventKind):
    """Sudden braking, or a surge, which switches SUMO's car following off."""

    heeds_sumo: bool = True  # whether who brakes does so at least as hard as SUMO would have

    def pauses(self, at: Moment) -> bool:
        """A surge pauses where somebody is near straight ahead, it has to stop, or SUMO changes its lane.

        For its own changes SUMO drives so that they are over before the edge is. A brake never pauses.
        """
        if at.event.kind == "brake":
            return False
        if at.vehicle.changes_by_itself():
            return True
        states, name = at.near(at.event.way + HALF_CORRIDOR), at.vehicle.name
        return not free_way(states[name], states.values(), at.event.way) or stops_ahead(at)

    def command(self, at: Moment) -> None:
        """Change the speed; who brakes does so as hard as the event, or as SUMO would have in the last step."""
        name, accel, speed = at.vehicle.name, at.event.accel, at.sumo.getSpeed(at.vehicle.name)
        if at.event.kind == "brake" and self.heeds_sumo:
            own = at.sumo.getAcceleration(name) + (at.sumo.getSpeedWithoutTraCI(name) - speed) / at.dt
            accel = min(accel, own)
        at.vehicle.hold_speed(RIGHT_OF_WAY if at.event.kind == "brake" else ALL_CHECKS_OFF)
        at.vehicle.drive(max(speed + accel * at.dt, 0.0))

    def give_back(self, at: Moment) -> None:
        """The speed is SUMO's."""
        at.vehicle.free_speed()


PUSH, HEEDLESS = Push(), Push(heeds_sumo=False)


@dataclass
class Running:
    """An event that is running, or pauses."""

    event: RiskEvent
    kind: EventKind
    began: float  # [s]
    acts: bool = False


class Change(NamedTuple):
    """A commanded lane change of a vehicle, whose lanes are held until the `end` [s].

    back: side of the lane to which it comes back then; 0 if it does not.
    """

    end: float
    back: int = 0


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
        traffic = scenario.traffic
        self._asks_for_markings = traffic is not None
        self._eidm = {type for type, model in traffic.models if model == "EIDM"} if traffic else set()
        self._waiting: dict[str, RiskEvent] = {}  # cut-ins that are due but cannot begin yet
        self._changes: dict[str, Change] = {}  # of vehicles whose lanes are commanded
        self._running: dict[str, Running] = {}  # what commands a vehicle, but for cut-ins
        self._returning: dict[str, float] = {}  # vehicles whose speed SUMO's EIDM gets back, and when [s]
        self._held: Any = self._waiting, self._changes, self._running, self._returning
        self._states: dict[str, State] = {}  # of all vehicles in this sub-step, once somebody has looked
        self._squares: dict[tuple[float, float], list[str]] = {}  # of the plane, with the vehicles there
        self._longest = LENGTH  # [m] of a vehicle that is there, at least of a car

    def act(self, time: float, dt: float) -> None:
        """Begin, continue and end events before the sub-step from `time` to `time` + `dt` [s]."""
        is_due = self._coming and self._coming[-1].time <= time + EARLY
        if not (is_due or any(self._held)):
            return
        self._states = {}
        while self._coming and self._coming[-1].time <= time + EARLY:
            event = self._coming.pop()
            if self._may_act(event.vehicle) and self._comes(event):
                if event.kind == "cut-in":
                    self._cut_in(event, time)
                else:
                    self._start(event, time, dt)
        for name in {name for held in self._held for name in held}:
            if not self._may_act(name):
                for held in self._held:
                    held.pop(name, None)
        for name in [name for name, end in self._returning.items() if time >= end - EARLY]:
            del self._returning[name]
            if not self._road[name].has_speed:
                self._road[name].drive(-1.0)
        for name, event in list(self._waiting.items()):
            del self._waiting[name]
            if time < event.time + DELAY:
                self._cut_in(event, time)
        for name, change in [(name, one) for name, one in self._changes.items() if time >= one.end - EARLY]:
            self._go_back(name, change, time)
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
        return frozenset(name for name in (*self._changes, *acting) if self._may_act(name))

    # -- lane changes --------------------------------------------------------------------------------------

    def _cut_in(self, event: RiskEvent, time: float) -> None:
        """Change to a neighbouring lane with room, as soon as a change may begin and no other event steers."""
        is_steered = self._road[event.vehicle].has_lanes and event.vehicle not in self._changes
        if is_steered or not self._may_begin(event.vehicle):
            self._waiting[event.vehicle] = event
            return
        oncoming = self._network.road.oncoming  # then the only lane beside is that of oncoming traffic
        for side in (-1,) if oncoming else (event.direction, -event.direction):
            if self._has_room(event.vehicle, side):
                self._change_lane(event.vehicle, time, side, SWERVE_TIME if oncoming else inf)
                return

    def _change_lane(self, name: str, time: float, side: int, seconds: float = inf) -> bool:
        """See `Moment.change_lane`."""
        beside = self._beside(name, side)
        if beside is None or name in self._changes:
            return False
        self._steer(name, side, beside)
        stays = seconds == inf
        end = time + (CHANGE_TIME if stays else max(seconds, CHANGE_TIME))
        self._changes[name] = Change(end, 0 if stays else -side)
        return True

    def _steer(self, name: str, side: int, beside: LaneIndex) -> None:
        """Command a lane change."""
        session, road = self._session, self._network.road
        self._road[name].hold_lanes(CHANGE)
        if road.oncoming:
            session.vehicle.changeLaneRelative(name, -side, 0.0)
            return
        lane = self._network.indices[session.vehicle.getLaneID(name)]
        limits = {road.lane(index).speed_limit for index in (lane, beside)}
        if len(limits) > 1 and not self._asks_for_markings:  # a faster lane makes nobody faster
            session.vehicle.setMaxSpeed(name, session.vehicle.getAllowedSpeed(name))
        session.vehicle.changeLane(name, self._network.sumo_index(beside), 0.0)

    def _go_back(self, name: str, change: Change, time: float) -> None:
        """Come back from a lane, as soon as there is room there, or give the lanes back to SUMO."""
        if change.back and time < change.end + PATIENCE:
            beside = self._beside(name, change.back)
            if beside is not None and (self._network.road.oncoming or self._has_room(name, change.back)):
                self._steer(name, change.back, beside)
                self._changes[name] = Change(time + CHANGE_TIME)
            return
        del self._changes[name]
        self._road[name].free_lanes(CHANGE)

    def _beside(self, name: str, side: int) -> LaneIndex | None:
        """The lane beside a vehicle to which a change may begin now, None if there is none."""
        session, of = self._session, self._session.vehicle
        lane = of.getLaneID(name)
        if lane not in self._network.indices or lane.startswith(":") or session.changes_lane(name):
            return None
        start, end, place = self._network.indices[lane]
        if self._network.road.oncoming and lane.rpartition("_")[0] not in of.getRoute(name):
            start, end = end, start  # it drives on the lane of oncoming traffic
        beside = self._network.road.beside((start, end, place), side)
        if beside is None or self._leads_off(name, beside) or not self._may_begin(name):
            return None
        # markings and classes, without which SUMO does not let a vehicle change there
        there, kind = self._network.lanes[beside].id, of.getVehicleClass(name)
        return beside if not self._asks_for_markings or session.may_change(lane, there, kind) else None

    def _may_begin(self, name: str) -> bool:
        """Whether a vehicle can begin a lane change now: it moves, and its edge goes on until the change is over."""
        of, takes = self._session.vehicle, self._session.lane_change_duration
        if not (lane := of.getLaneID(name)) or lane.startswith(":"):
            return False
        return self._road[name].may_begin_change(of.getSpeed(name) + of.getAccel(name) * takes / 2.0)

    def _leads_off(self, name: str, beside: LaneIndex) -> bool:
        """Whether the lane beside leads along another route than the vehicle's.

        With SUMO's own files that counts where lane changes take their time, which SUMO breaks down over, and where
        the vehicle could not stop before the end of that lane, at which SUMO would stop it at once.
        """
        session, there = self._session, self._network.lanes[beside].id
        if self._asks_for_markings:
            speed, place = session.vehicle.getSpeed(name), session.vehicle.getLanePosition(name)
            needed = inf if session.lane_change_duration else self._road[name].way_to_stop(speed)
            ways = session.lanes_ahead(name)
            return any(lane == there and not leads and end - place < needed for lane, end, leads in ways)
        way = session.vehicle.getRouteID(name)
        return way in self._network.routes and way != self._network.leading_on(way, there)

    def _has_room(self, name: str, side: int) -> bool:
        """See `Moment.has_room`."""
        if (beside := self._beside(name, side)) is None:
            return False
        x, y, speed, _ = self._look()[name]
        geometry = self._network.road.lane(beside)
        s, _ = geometry.local_coordinates(x, y)
        there = *geometry.position(s, 0.0), speed, geometry.heading_at(s)
        states = self._near(*there[:2], LOOKED_AT + self._longest)
        states.pop(name, None)
        sizes = self._session.halves((name, *states))
        # what is smaller than a car is given the room of one
        halves = [(max(length, CAR[0]), max(width, CAR[1])) for length, width in sizes]
        return has_room(there, list(states.values()), halves)

    # -- all other kinds -----------------------------------------------------------------------------------

    def _at(self, running: Running, time: float, dt: float) -> Moment:
        event, name = running.event, running.event.vehicle

        def near(reach: float) -> Mapping[str, State]:
            return self._near(*self._look()[name][:2], reach)

        of, elapsed = self._session.vehicle, time - running.began
        lanes = partial(self._has_room, name), partial(self._change_lane, name, time)
        return Moment(event, self._road[name], of, dt, self._look, near, elapsed, *lanes)

    def _start(self, event: RiskEvent, time: float, dt: float) -> None:
        """An event begins; one of another kind on this vehicle ends."""
        kind = event.kind
        if not isinstance(kind, EventKind):
            kind = HEEDLESS if self._is_eidm(event.vehicle) else PUSH
        before = self._running.get(event.vehicle)
        acts = before is not None and before.acts
        if before is not None and acts and before.kind != kind:
            self._give_back(before, self._at(before, time, dt))
            acts = False
        self._running[event.vehicle] = Running(event, kind, time, acts)

    def _go_on(self, name: str, running: Running, time: float, dt: float) -> None:
        """Command a vehicle for one sub-step, or give it back to SUMO."""
        at, acted = self._at(running, time, dt), running.acts
        ended = at.elapsed >= running.event.duration - EARLY
        running.acts = not ended and not running.kind.pauses(at)
        if ended:
            del self._running[name]
        if running.acts:
            running.kind.command(at)
        elif acted:
            self._give_back(running, at)

    def _give_back(self, running: Running, at: Moment) -> None:
        """Give SUMO what an event has taken; its EIDM gets the speed within limits at first, see `SETTLING`."""
        vehicle, had_speed = at.vehicle, at.vehicle.has_speed
        running.kind.give_back(at)
        if had_speed and not vehicle.has_speed and self._is_eidm(vehicle.name):
            vehicle.drive(UNLIMITED)
            self._returning[vehicle.name] = running.began + at.elapsed + SETTLING

    def _is_eidm(self, name: str) -> bool:
        return bool(self._eidm) and self._session.type_of(name) in self._eidm
