"""Where two vehicles can meet on a SUMO network, which their outlines in plan view do not say.

A bridge is drawn over the road below it, and SUMO knows two roads that cross without a junction. So a contact needs
more than outlines: the way from one vehicle to the other along the roads has to be short. It is short on one edge,
across a junction that joins two edges, and within a junction. Two edges count as one road where they are the two
directions between two junctions (opposite lanes, `bidi`), and as far as they run side by side from a junction (a ramp
that joins at a small angle).
"""

from collections.abc import Iterable, Mapping
from heapq import heappop, heappush
from math import inf
from typing import Any, NamedTuple

# [m] That the way along one edge, or across the junction that joins two, may be longer than the vehicles: SUMO's length
# of an edge may be a multiple of the drawn one. A road that loops back over itself has a longer way.
JOINED = 50.0
MOST_APART = 5.0  # [m] between the middles of two lanes on which vehicles can touch
SAMPLE = 5.0  # [m] between the points of a lane that are looked at
FURTHEST = 100.0  # [m] between two junctions that are looked at: TTC_RADIUS of `sumo_env.contacts.measures`
CLEARANCE = 3.0  # [m] of height between two roads, one above the other
STEEPEST = 0.15  # metres of height per metre of road
STRETCHED = 1.1  # SUMO's length of a lane over its drawn length, from which on its drawing says little
MOST_PASSED = 30  # lanes that a vehicle drives over in a step


class Spot(NamedTuple):
    """Where SUMO has the front of a vehicle: the id of its lane, the metres along the lane, the height [m]."""

    lane: str
    position: float
    height: float = 0.0


class Meeting:
    """Which vehicles can meet on one network."""

    def __init__(self, net: Any, lanes: Mapping[str, Any]) -> None:
        """Read a network of sumolib (with the lanes inside junctions); lanes: `SumoLane` by their ids."""
        self._lanes = lanes
        self._inside: dict[str, list[tuple[str, str]]] = {}  # see `inside`
        for start, found in lanes.items():
            for lane in () if start.startswith(":") else found.following:
                while lane.startswith(":"):  # a long way is made of several lanes
                    before, lane = lane, next(iter(lanes[lane].following), "")
                    self._inside.setdefault(lane, []).append((before, edge_of(start)))
        self._together: dict[tuple[str, str, str], float] = {}  # see `_side_by_side`
        self._edges: dict[str, _Edge] = {}
        # junction -> (a next one, metres between them)
        self._leading: dict[str, list[tuple[str, float]]] = {}
        self._ways: dict[str, dict[str, float]] = {}  # see `_ways_from`
        for edge in net.getEdges():
            name, start, end = edge.getID(), edge.getFromNode().getID(), edge.getToNode().getID()
            inside = name.startswith(":")
            self._edges[name] = _Edge(start, end, 0.0 if inside else edge.getLength())
            if not inside:
                self._leading.setdefault(start, []).append((end, edge.getLength()))
                self._leading.setdefault(end, []).append((start, edge.getLength()))

    def can_meet(self, one: Spot, other: Spot, lengths: float, driven: float) -> bool:
        """Whether two vehicles can be in contact, now or in a moment.

        Args:
            one, other: where they are now.
            lengths: of both together [m]; the back of a long vehicle may be several edges behind its front.
            driven: by both together until then [m]; 0 for now.
        """
        if abs(one.height - other.height) > CLEARANCE + STEEPEST * driven:
            return False
        first, second = edge_of(one.lane), edge_of(other.lane)
        if first not in self._edges or second not in self._edges:
            return True  # off the road, where somebody else has put it
        reach = lengths + driven
        if first == second and not first.startswith(":"):
            return abs(one.position - other.position) - JOINED <= reach
        own, others = self._edges[first], self._edges[second]
        if (own.start, own.end) == (others.end, others.start) and own.length and others.length:
            return True
        for junction, way in own.ways_to_ends(one.position):
            for goal, further in others.ways_to_ends(other.position):
                gap = way + further - reach
                if junction != goal:
                    gap += self._ways_from(junction).get(goal, inf)
                elif gap > JOINED:
                    gap -= JOINED + 2.0 * self._side_by_side(one.lane, other.lane, junction)
                if gap <= 0.0:
                    return True
        return False

    def inside(self, spot: Spot, length: float, edge: str) -> list[str]:
        """Lanes inside a junction on which a vehicle of this length [m] is that has come there from an edge."""
        found = [spot.lane] if spot.lane.startswith(":") else []
        if spot.position < length:
            found += [lane for lane, start in self._inside.get(spot.lane, ()) if start == edge]
        return found

    def is_stretched(self, lane: str) -> bool:
        """Whether vehicles on a lane are nearer to each other in the drawing than in SUMO's metres."""
        found = self._lanes.get(lane)
        return found is not None and found.length > STRETCHED * found.drawn > 0.0

    def leads(self, before: str, after: str) -> bool:
        """Whether a vehicle that drives on, and does not change lane, gets from one lane to another in a step."""
        reached: Iterable[str] = (before,)
        for _ in range(MOST_PASSED):
            if after in reached:
                return True
            reached = {
                lane for name in reached if name in self._lanes for lane in self._lanes[name].following
            }
        return False

    def _side_by_side(self, one: str, other: str, junction: str) -> float:
        """How far from a junction a lane stays beside another one, in SUMO's metres of the first."""
        key = one, other, junction
        found = self._together.get(key)
        if found is None:
            from sumolib.geomhelper import distancePointToPolygon, polyLength, positionAtShapeOffset

            shape, ends, found = self._lanes[one].shape, self._edges[edge_of(one)], 0.0
            shape = shape if ends.start == junction else shape[::-1]
            drawn = polyLength(shape)
            while ends.length and found < drawn:  # 0 for lanes inside junctions
                point = positionAtShapeOffset(shape, found)
                if point is None or distancePointToPolygon(point, self._lanes[other].shape) > MOST_APART:
                    break
                found += SAMPLE
            found *= ends.length / drawn if found else 0.0
            self._together[key] = found
        return found

    def _ways_from(self, junction: str) -> dict[str, float]:
        """The least way along the roads, in whatever direction, to each junction within `FURTHEST` of this one [m].

        The lanes inside junctions count nothing.
        """
        found = self._ways.get(junction)
        if found is None:
            found = self._ways[junction] = {}
            queue = [(0.0, junction)]
            while queue:
                way, node = heappop(queue)
                if node not in found:
                    found[node] = way
                    for following, length in self._leading.get(node, ()):
                        if way + length <= FURTHEST:
                            heappush(queue, (way + length, following))
        return found


class _Edge(NamedTuple):
    """The junctions at both ends of an edge, and its length [m]; within a junction this one twice, and 0."""

    start: str
    end: str
    length: float

    def ways_to_ends(self, position: float) -> tuple[tuple[str, float], ...]:
        """How far the junctions are from `position` [m] of the edge."""
        if not self.length:
            return ((self.start, 0.0),)
        return (self.start, position), (self.end, self.length - position)


def edge_of(lane: str) -> str:
    """The edge of a lane."""
    return lane.rpartition("_")[0]
