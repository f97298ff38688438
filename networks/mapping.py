"""The built networks, and the way from highway-env's lanes to SUMO's edges, lanes, positions and routes.

A simulator needs only `network(road)`. SUMO's names follow highway-env's: edge "se-ex" leads from node se to
node ex; within an edge SUMO counts lanes from the right, highway-env from the left. Highway-env's lanes inside the
intersection ("ir0" -> "il1") are SUMO's internal lanes; all other internal lanes are short joints without a
counterpart. The two-way road's ("a","b",0) is the oncoming lane driven the wrong way: SUMO's "b-a_0".
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any

from sumo_env.networks import plans
from sumo_env.networks.lanes import VEHICLE_LENGTH, Lane, Point, SineLane
from sumo_env.networks.meeting import Meeting, edge_of
from sumo_env.networks.roads import LaneIndex, Road

FOLDER = Path(__file__).resolve().parent
# [m] that a lane of SUMO's network may be beside highway-env's, and shorter at either end
ASIDE, SHORT = 0.5, 1.5
ON_FOOT = ("walkingarea", "crossing")  # edges inside junctions on which people walk


@dataclass(frozen=True, slots=True)
class SumoLane:
    """A lane of the built network.

    SUMO gives all lanes of an edge one `length`; in bends it differs from the `drawn` length of the lane's shape.
    """

    id: str
    length: float  # in which SUMO counts positions [m]
    drawn: float  # along the shape [m]
    shape: tuple[Point, ...]  # points of its middle, in highway-env's coordinates [m]
    following: tuple[str, ...]  # ids of the lanes and joints that may come next
    preceding: tuple[str, ...]  # likewise, that come before
    classes: frozenset[str]  # SUMO's vehicle classes that may drive here


@dataclass(frozen=True)
class Network:
    """A road in highway-env and in SUMO."""

    road: Road
    net_file: Path
    # "<from>-<to>><end>" -> SUMO edges, for a vehicle on the road <from> -> <to> bound for <end>. They begin one edge
    # before the vehicle's own where there is one, because SUMO shifts a vehicle by metres that is placed on a joint
    # when its route lacks the edge before.
    routes: Mapping[str, tuple[str, ...]]
    lanes: Mapping[LaneIndex, SumoLane]  # highway-env's lane -> SUMO's
    indices: Mapping[str, LaneIndex]  # SUMO lane id -> highway-env's lane; of a joint, the lane it leads to
    sumo_lanes: Mapping[str, SumoLane]  # SUMO lane id -> SUMO's lane, joints included
    # which vehicles can meet; None where no road crosses another one without a junction: all can
    meeting: Meeting | None = None

    def stretch(self, sumo_lane: str) -> float:
        """SUMO's length of a lane over its drawn length, if it has one: the factor for a commanded ground speed."""
        lane = self.sumo_lanes[sumo_lane]
        return lane.length / lane.drawn if lane.drawn > 0.0 else 1.0

    def sumo_route(self, index: LaneIndex, destination: str | None = None) -> str:
        """Key in `routes` for a vehicle on lane `index` bound for node `destination`.

        A node short of an end ("nxs") stands for the end that follows it; None for the only end there is, or where
        lanes part for the one that the lane leads to, else the first one. Raises ValueError, naming the choices, if no
        route leads there.
        """
        start = f"{index[0]}-{index[1]}>"
        if destination is None:
            ends = [key for key in self.routes if key.startswith(start)]
            if len(ends) == 1 or (ends and self.parting):
                return self.leading_on(ends[0], self.lanes[index].id)
        else:
            end = destination
            while end not in self.road.ends and len(self.road.successors.get(end, ())) == 1:
                (end,) = self.road.successors[end]
            if start + end in self.routes:
                return start + end
        choices = ", ".join(key.split(">")[1] for key in self.routes if key.startswith(start))
        raise ValueError(f"no route from {index} to {destination!r} on {self.road.name}; ends: {choices}")

    @cached_property
    def junctions(self) -> Mapping[tuple[str, str], float]:
        """Length [m] of the way through the junction from one of SUMO's edges to another one, on the rightmost lane."""
        found: dict[tuple[str, str], float] = {}
        for start, lane in self.sumo_lanes.items():
            for name in () if start.startswith(":") else lane.following:
                way = 0.0
                while name.startswith(":"):  # a long way is made of several lanes
                    way += self.sumo_lanes[name].length
                    name = next(iter(self.sumo_lanes[name].following), "")
                found.setdefault((edge_of(start), edge_of(name)), way)
        return found

    @cached_property
    def parting(self) -> Mapping[str, frozenset[str]]:
        """SUMO's lanes that lead on to fewer edges than the lanes beside them, with these edges."""
        joints = {lane.id: lane.following for lane in self.lanes.values() if not lane.id.startswith(":")}
        leads = {
            name: frozenset(edge_of(self.sumo_lanes[joint].following[0]) for joint in following)
            for name, following in joints.items()
        }
        whole: dict[str, frozenset[str]] = {}
        for name, edges in leads.items():
            whole[edge_of(name)] = whole.get(edge_of(name), frozenset()) | edges
        return {name: edges for name, edges in leads.items() if edges and edges != whole[edge_of(name)]}

    def leading_on(self, key: str, lane: str) -> str:
        """The key of a route that a SUMO lane leads along: `key`, or where lanes part that of another end."""
        for other in (key, *self.routes) if lane in self.parting else ():
            edges, edge = self.routes[other], edge_of(lane)
            if edge in edges[:-1] and edges[edges.index(edge) + 1] in self.parting[lane]:
                return other
        return key

    def sumo_index(self, index: LaneIndex) -> int:
        """SUMO's number of a lane on its edge, 0 for the rightmost."""
        return int(self.lanes[index].id.rpartition("_")[2])

    def place(
        self, index: LaneIndex, s: float, destination: str | None = None, half: float = VEHICLE_LENGTH / 2
    ) -> tuple[str, str, float]:
        """Where SUMO has to put a vehicle whose centre highway-env has `s` [m] along lane `index`.

        Returns (key of its route, SUMO lane id, position of its front bumper [m] for `vehicle.moveTo`).
        The bumper is half a vehicle (`half` [m]) ahead of the centre, possibly past a joint; `s` outside the lane is
        followed along the route. Raises ValueError for a lane that SUMO drives the wrong way, and beyond
        the ends of the network.
        """
        if self.road.oncoming and index == ("a", "b", 0):
            raise ValueError('place on ("a", "b", 1) and change lane: SUMO has no eastbound lane at y = 0')
        key, lane = self.sumo_route(index, destination), self.lanes[index]
        edges = self.routes[key]
        # Inside the intersection there is no edge: count from the entry, the first edge of the route.
        edge = 0 if lane.id.startswith(":") else edges.index(edge_of(lane.id))
        first, _ = self.road.lane(index).local_coordinates(*lane.shape[0])
        ahead = _travelled(self.road.lane(index), first, s) + half
        while not 0 <= ahead <= lane.drawn:
            step = 1 if ahead > 0 else -1
            beside = self._beside(lane.id, edges, edge, step)
            if beside is None:
                raise ValueError(f"s = {s} m on lane {index} is not on route {key} of {self.road.name}")
            if step > 0:
                ahead -= lane.drawn
                edge += lane.id.startswith(":")
                lane = self.sumo_lanes[beside]
            else:
                edge -= not lane.id.startswith(":")
                lane = self.sumo_lanes[beside]
                ahead += lane.drawn
        return key, lane.id, ahead * lane.length / lane.drawn

    def _beside(self, lane: str, edges: tuple[str, ...], edge: int, step: int) -> str | None:
        """The lane or joint after (step 1) or before (-1) a SUMO lane on a route; the rightmost one."""

        def near(name: str) -> tuple[str, ...]:
            return self.sumo_lanes[name].following if step > 0 else self.sumo_lanes[name].preceding

        if lane.startswith(":"):
            return min(near(lane), default=None)
        if not 0 <= edge + step < len(edges):
            return None
        wanted = edges[edge + step]
        return min((joint for joint in near(lane) if edge_of(near(joint)[0]) == wanted), default=None)


def _travelled(lane: Lane, start: float, end: float) -> float:
    """Metres along the curve from s = `start` to s = `end` [m]; a sine lane counts s along its axis."""
    if not isinstance(lane, SineLane) or start == end:
        return end - start
    points = plans.sample(lane, min(start, end), max(start, end))
    return math.copysign(sum(math.dist(a, b) for a, b in pairwise(points)), end - start)


@lru_cache(maxsize=16)
def network(road: Road) -> Network:
    """The network of a road.

    Raises:
        ValueError: none has been built for it, or its lanes are not where the road's are.
    """
    net_file = FOLDER / road.net_file
    if not net_file.is_file():
        raise ValueError(f"the road {road.name!r}{_how(road)} has no SUMO network: {net_file} is missing")
    sumo_lanes = sumo_lanes_of(read_net(net_file))
    lanes = {index: sumo_lanes[_sumo_lane_id(road, index, sumo_lanes)] for index in road.lanes}
    for index, found in lanes.items():
        _check(road, index, found)
    indices = {lane.id: index for index, lane in lanes.items()}
    for lane in sumo_lanes.values():
        if lane.id.startswith(":"):
            indices.setdefault(lane.id, indices[lane.following[0]])
    return Network(road, net_file, _routes(road, sumo_lanes), lanes, indices, sumo_lanes)


def _how(road: Road) -> str:
    return "".join(f", {name} {value:g}" for name, value in road.arguments)


def _check(road: Road, index: LaneIndex, found: SumoLane) -> None:
    """That SUMO's lane lies on highway-env's, from end to end."""
    lane = road.lane(index)
    (first, aside), (last, beside) = sorted(
        lane.local_coordinates(*point) for point in (found.shape[0], found.shape[-1])
    )
    if max(abs(aside), abs(beside)) > ASIDE or first > SHORT or last < lane.length - SHORT:
        raise ValueError(
            f"SUMO's lane {found.id!r} does not lie on lane {index} of the road {road.name!r}{_how(road)}: it goes "
            f"from s = {first:.1f} to {last:.1f} m of {lane.length:.1f} m, {aside:.1f} and {beside:.1f} m beside it"
        )


def read_net(net_file: Path) -> Any:
    """A network as sumolib has it, lanes inside junctions included."""
    # sumolib takes 0.1 s to load, which only processes that run SUMO have to wait for
    from sumolib.net import readNet

    name = str(net_file)
    with net_file.open("rb") as opened:  # sumolib fails at names that are no text, as umlauts in the locale C
        return readNet(name if name.isprintable() else f"/dev/fd/{opened.fileno()}", withInternal=True)


def joints_of(lane: Any) -> list[Any]:
    """The connections of a lane of sumolib that begin and end where vehicles drive."""
    edges = [(joint, (lane.getEdge(), joint.getToLane().getEdge())) for joint in lane.getOutgoing()]
    return [joint for joint, ends in edges if not any(end.getFunction() in ON_FOOT for end in ends)]


def sumo_lanes_of(net: Any) -> dict[str, SumoLane]:
    """All lanes of a network that sumolib has read, by their ids."""
    from sumolib.geomhelper import polyLength

    lanes = {lane.getID(): lane for edge in net.getEdges() for lane in edge.getLanes()}
    following = {
        name: tuple(joint.getViaLaneID() or joint.getToLane().getID() for joint in joints_of(lane))
        for name, lane in lanes.items()
    }
    preceding: dict[str, list[str]] = {name: [] for name in lanes}
    for before, after in following.items():
        for name in dict.fromkeys(after):
            preceding[name].append(before)
    return {
        name: SumoLane(
            name,
            lane.getLength(),
            polyLength(lane.getShape()),
            tuple((x, -y) for x, y in lane.getShape()),
            following[name],
            tuple(preceding[name]),
            frozenset(lane.getPermissions()),
        )
        for name, lane in lanes.items()
    }


def _sumo_lane_id(road: Road, index: LaneIndex, sumo_lanes: Mapping[str, SumoLane]) -> str:
    """Id of the SUMO lane that is highway-env's lane `index`."""
    start, end, i = index
    if road.oncoming:
        return "a-b_0" if index == ("a", "b", 1) else "b-a_0"
    name = f"{start}-{end}_{road.count(start, end) - 1 - i}"
    if name in sumo_lanes:
        return name
    inside = [
        lane.id
        for lane in sumo_lanes.values()
        if lane.id.startswith(":")
        and edge_of(lane.preceding[0]).endswith(f"-{start}")
        and lane.following[0].startswith(f"{end}-")
    ]
    if len(inside) != 1:
        raise ValueError(f"SUMO's network of the road {road.name!r} has no lane {name!r} for {index}")
    return inside[0]


def _routes(road: Road, sumo_lanes: Mapping[str, SumoLane]) -> dict[str, tuple[str, ...]]:
    """See `Network.routes`."""
    edges = {edge_of(lane) for lane in sumo_lanes if not lane.startswith(":")}
    pairs = list(dict.fromkeys((start, end) for start, end, _ in road.lanes))
    ends = road.ends
    routes: dict[str, tuple[str, ...]] = {}
    for start, end in pairs:
        # the ring before the arm that enters it; inside the intersection the one way in;
        # nothing before an end, where highway-env's graph turns back
        before = sorted((p for p in pairs if p[1] == start), key=lambda p: -road.count(*p))
        earlier = [] if start in ends else before[:1]
        for goal in ends:
            path = (start, end) if goal == end else (start, *road.route(end, goal))
            if path[-1] == goal and not any(node in ends for node in path[1:-1]):
                steps = [f"{a}-{b}" for a, b in (*earlier, *pairwise(path))]
                routes[f"{start}-{end}>{goal}"] = tuple(step for step in steps if step in edges)
    return routes
