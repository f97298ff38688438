"""What is near the ego after every sub-step.

SUMO is asked vehicle by vehicle where the ego is, and everybody who may be within reach. Its context subscription gives
the same states and takes longer than the rest of a sub-step on small roads (docs/developers/decisions.md).
"""

from collections.abc import Collection, Mapping
from itertools import chain, product
from math import inf
from operator import itemgetter
from typing import Any

from sumo_env.contacts.crash import SUMO_TOLERANCE
from sumo_env.contacts.measures import TTC_RADIUS, ego_ttc
from sumo_env.contacts.rectangles import DIAGONAL, Half, State, reach_of, separation, stay_apart
from sumo_env.networks.meeting import Meeting, Spot, edge_of
from sumo_env.scene import NOBODY, PERCEPTION_DISTANCE, Neighbour
from sumo_env.sumo.session import Session

FASTEST = 200.0  # [m/s] no two vehicles close in faster
NOWHERE = 1e8  # [m] so far away are those that SUMO is teleporting, which may be back at any time
LONG = 10.0  # [m] from which on a vehicle is drawn across the lane beside in a turn
# Shapes of vehicles of several parts: SUMO's angle is that of the first one, and the others follow the lane.
BENDING = {"bus/flexible", "rail", "rail/railcar", "rail/cargo", "truck/semitrailer", "truck/trailer"}


class Surroundings:
    """The ego and the vehicles near it, those that somebody else has added to the simulation included.

    meeting: which vehicles can meet on the network; None where all can.
    """

    def __init__(self, session: Session, ego: str, speed: float, meeting: Meeting | None) -> None:
        self._session, self._name, self._meeting = session, ego, meeting
        self._spot: Spot | None = None  # the ego's, once asked for
        self._lanes: dict[str, str] = {}  # of the ego and of those near it, on networks with a `meeting`
        self.ego: State
        self.near: dict[str, State]  # whose front is within `TTC_RADIUS` of the ego's, in alphabetical order
        self.list_vehicles()
        self.update(0.0, speed)

    def list_vehicles(self) -> None:
        """Read which vehicles are on the road, and look at all of them next."""
        self._list_others()
        self._due: dict[str, float] = {}  # distant vehicle -> time before which it cannot be near [s]

    def _list_others(self) -> None:
        self._others = [name for name in self._session.vehicles() if name != self._name]

    def update(self, time: float, speed: float, commanded: Mapping[str, float] = {}) -> None:
        """Look around after the sub-step that ended at `time` [s] with the ego's `speed` [m/s].

        A distant vehicle is skipped until it may have come near (conservative advancement). commanded: speeds [m/s] of
        vehicles whose speed in SUMO only covers the way of a sub-step.
        """
        if self._session.changed:
            self._list_others()
            for name in self._session.simulation.getDepartedIDList():  # perhaps a name of one that has left
                self._due.pop(name, None)
        others, due = self._others, self._due
        if due:
            others = [name for name in others if due.get(name, time) <= time]
        (x, y, _, heading), self.near, distant = self._session.near(self._name, others, TTC_RADIUS)
        self._spot = None
        if self._meeting is not None:
            lane, self._lanes_before = self._session.vehicle.getLaneID, self._lanes
            self._lanes = {name: lane(name) for name in (self._name, *self.near)}
        self.ego = x, y, speed, heading
        for name in commanded.keys() & self.near.keys() if commanded else ():
            its_x, its_y, _, its_heading = self.near[name]
            self.near[name] = its_x, its_y, commanded[name], its_heading
        due |= {name: time + further / FASTEST for name, further in distant if further < NOWHERE}

    def time_to_collision(self, horizon: float) -> float:
        """Least time to collision of the ego with a vehicle that it can meet [s], inf without one within `horizon`."""
        sizes = self._session.sizes
        if not sizes:
            least = ego_ttc(self.ego, self.near.values(), horizon)
            if self._meeting is None or least == inf:
                return least
        least, own, halves = inf, self._own_half(), self._session.halves(self.near)
        for (name, other), half in zip(self.near.items(), halves, strict=True):
            time = ego_ttc(self.ego, (other,), min(horizon, least), half, own)
            if time < least and self._can_meet(name, half, time):
                least = time
        return least

    def within_reach(
        self, ego: State, before: dict[str, State], dt: float, reported: Collection[str]
    ) -> list[str]:
        """Who may have touched the ego in the last `dt` [s], or nearly; `ego` and `before` are the states then.

        reported: whom SUMO reports in collision with the ego, and who therefore can meet it.
        """
        x, y, _, _ = self.ego
        reach = DIAGONAL + SUMO_TOLERANCE
        if self._session.sizes:
            own = self._own_half()
            reach = max((reach_of(half, own) for half in self._session.halves(self.near)), default=DIAGONAL)
            reach += SUMO_TOLERANCE
        far = reach + FASTEST * dt
        found = []
        for name, other in self.near.items():
            dx, dy = other[0] - x, other[1] - y
            if -far < dx < far and -far < dy < far and name in before:
                was = before[name]
                if not stay_apart(was[0] - ego[0], was[1] - ego[1], dx, dy, reach):
                    found.append(name)
        if self._meeting is None or not found:
            return found
        halves = dict(zip(found, self._session.halves(found), strict=True))
        return [
            name
            for name in found
            if name in reported
            or (
                not self._is_drawn_otherwise(name)
                and self._can_meet(name, halves[name], dt)
                and not self._has_jumped_past(name, halves[name])
            )
        ]

    def _has_jumped_past(self, name: str, half: Half) -> bool:
        """Whether they are apart after a lane change of one of them, which SUMO makes without a way in between."""
        before, after, meeting = self._lanes_before, self._lanes, self._meeting
        assert meeting is not None
        jumped = any(
            not meeting.leads(before[one], after[one]) for one in (name, self._name) if one in before
        )
        return jumped and separation(self.ego, self.near[name], self._own_half(), half) > 0.0

    def passes(self, name: str, is_sumos: bool) -> bool:
        """Whether a touch of the ego and another vehicle is one of outlines alone, which SUMO's rules allow.

        Their ways through a junction are in no conflict by SUMO's matrix, or both are on lanes and `is_sumos`: SUMO
        alone drives the ego. Of a long vehicle, which SUMO draws across the lane beside in a turn, also where they are
        on two lanes of an edge, or only one of them is in the junction.
        """
        if self._meeting is None:
            return False
        lane, beside = self._lanes[self._name], self._lanes[name]
        if is_sumos and beside:
            return True
        is_long = 2.0 * max(self._session.half(one) for one in (self._name, name)) > LONG
        if is_long and lane != beside and edge_of(lane) == edge_of(beside):
            return True
        of, foes = self._session, self._session.sumo.lane.getInternalFoes
        own, others = (
            self._meeting.inside(of.spot(one), 2.0 * of.half(one), of.edge_before(one))
            for one in (self._name, name)
        )
        pairs = list(product(own, others))
        known = any(one == other or other in foes(one) or one in foes(other) for one, other in pairs)
        return bool(own or others if is_long else pairs) and not known

    def _is_drawn_otherwise(self, name: str) -> bool:
        """Whether outlines say nothing: of this vehicle and the ego, one has several parts or a stretched lane."""
        assert self._meeting is not None
        return any(
            self._session.vehicle.getShapeClass(one) in BENDING
            or self._meeting.is_stretched(self._lanes[one])
            for one in (name, self._name)
        )

    def _own_half(self) -> Half:
        """The ego's half size [m]."""
        return self._session.halves((self._name,))[0]

    def _can_meet(self, name: str, half: Half, time: float) -> bool:
        """Whether the network lets the ego and a vehicle of half size `half` [m] be in contact within `time` [s]."""
        if self._meeting is None:
            return True
        if self._spot is None:
            self._spot = self._session.spot(self._name)
        driven = (abs(self.ego[2]) + abs(self.near[name][2])) * time
        lengths = 2.0 * (self._own_half()[0] + half[0])
        return self._meeting.can_meet(self._spot, self._session.spot(name), lengths, driven)


def neighbours(session: Session, name: str) -> tuple[Neighbour, ...]:
    """Leader and follower of a vehicle in the lane on SUMO's left, in its own lane, and in that on the right."""
    of = session.vehicle
    own = of.getLeader(name, PERCEPTION_DISTANCE), of.getFollower(name, PERCEPTION_DISTANCE)
    leaders = of.getLeftLeaders(name), filter(None, own[:1]), of.getRightLeaders(name)
    followers = of.getLeftFollowers(name), filter(None, own[1:]), of.getRightFollowers(name)
    around = []
    for side in zip(leaders, followers, strict=True):
        for behind, found in enumerate(side):
            nearest = NOBODY
            for other, further in found:
                if other:  # SUMO's gaps are those beyond the minGap of the vehicle behind
                    gap = further + of.getMinGap(other if behind else name)
                    nearest = min(nearest, Neighbour(other, gap, of.getSpeed(other)), key=itemgetter(1))
            around.append(nearest)
    return tuple(around)


def foe(session: Session, name: str) -> Neighbour:
    """Of the vehicles to which a vehicle has to give way at the next junction, the one nearest to the junction.

    Its gap is what is left of its way there, 0 within the junction. Only vehicles on the last lane before the junction
    are looked at, and none that a red light stops. Nothing that is asked here draws SUMO's random numbers
    (`getNextLinks` does).
    """
    lanes, vehicles = session.sumo.lane, session.vehicle
    lane, nearest = vehicles.getLaneID(name), NOBODY
    ways = _ways_on(session, name, lane) if lane else ()  # a vehicle that is parked has none
    if not ways or not ways[0][4]:  # its lane does not lead on, or nothing more is crossed
        return nearest
    crossed = lanes.getInternalFoes(ways[0][4])
    for before in dict.fromkeys(lanes.getFoes(lane, ways[0][0])):
        is_inside = before.startswith(":")
        inside = [before] if is_inside else [link[4] for link in lanes.getLinks(before)]
        for other in chain.from_iterable(
            lanes.getLastStepVehicleIDs(way) for way in inside if way in crossed
        ):
            nearest = min(nearest, Neighbour(other, 0.0, vehicles.getSpeed(other)), key=itemgetter(1))
        for other in () if is_inside else lanes.getLastStepVehicleIDs(before):
            link = _ways_on(session, other, before)[:1]
            if link and link[0][4] in crossed and link[0][5] not in "ru":
                gap = lanes.getLength(before) - vehicles.getLanePosition(other)
                nearest = min(nearest, Neighbour(other, gap, vehicles.getSpeed(other)), key=itemgetter(1))
    return nearest


def _ways_on(session: Session, name: str, lane: str) -> list[Any]:
    """SUMO's links from a vehicle's lane to the edge that its route goes on with, the one that it will take first."""
    of, links = session.vehicle, list(session.sumo.lane.getLinks(lane))
    if lane.startswith(":"):  # there is one way on
        return links
    onward = of.getRoute(name)[of.getRouteIndex(name) + 1 :][:1]
    links = [link for link in links if link[0].rpartition("_")[0] in onward]
    if len(links) > 1:
        best = {lanes[1] for here, *_, lanes in of.getBestLanes(name) if here == lane and len(lanes) > 1}
        links.sort(key=lambda link: link[0] not in best)
    return links
