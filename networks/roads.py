"""The roads of the tasks, lane for lane those of highway-env 1.12.1.

A lane is named by highway-env's index (from node, to node, lane id); id 0 is the left lane of a road. `Road` answers
questions of geometry, and has no vehicles. Numbers are those of highway_env/envs/*_env.py. SUMO's: `networks.mapping`.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sumo_env.networks.lanes import WIDTH, CircularLane, Lane, Point, SineLane, StraightLane, quarter_turns

LaneIndex = tuple[str, str, int]

FEW = 6  # lanes that are all looked at for the closest one: finding out which matter would cost more
CONTINUES = 0.75  # widths that the next lane may be beside the end of the one that it continues
SAMPLE = 1.0  # [m] between the points that stand for a lane of more


@dataclass
class Road:
    """An immutable set of named lanes and the graph that they form.

    `lanes` keeps the order in which highway-env stores them, which decides ties in `closest_lane`. `arguments` are
    those of `road`, beside the name. Roads of the same value are equal.

    obstacles: centres of boxes of 2 m by 2 m that stand on the road [m], parallel to x.
    ends: nodes at which vehicles leave the road.
    net_file: its SUMO network, a file of this folder or a path of a user's own (`networks.mapping`).
    oncoming: whether the lane to the left is that of oncoming traffic.
    clears_exits: whether vehicles are taken off shortly before the end of an exit (IntersectionEnv._clear_vehicles).
    joined: whether lanes continue others, so that highway-env's connected lanes make a difference.
    regulated: whether highway-env applies right of way (``RegulatedRoad``).
    turned_by_matrix: whether highway-env computes lanes by turning those of one arm (``IntersectionEnv._make_road``).
    stops: lanes with a stop line at their end, on SUMO's own networks, and the lights there, from right to left: of
        each way on the id of the traffic light and its place among that light's letters; none where one gives way.
    """

    name: str
    lanes: Mapping[LaneIndex, Lane]
    arguments: tuple[tuple[str, float], ...] = ()
    obstacles: tuple[Point, ...] = ()
    ends: tuple[str, ...] = ()
    net_file: str = ""
    oncoming: bool = False
    clears_exits: bool = False
    joined: bool = False
    regulated: bool = False
    turned_by_matrix: bool = False
    stops: Mapping[LaneIndex, tuple[tuple[str, int], ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.lanes = dict(_graph_order(self.lanes))
        self._counts = dict(Counter(index[:2] for index in self.lanes))
        self.successors: dict[str, tuple[str, ...]] = {}
        for start, end in self._counts:
            self.successors[start] = (*self.successors.get(start, ()), end)

    def __repr__(self) -> str:
        return f"Road({self.name!r}, {len(self.lanes)} lanes)"

    def __hash__(self) -> int:
        return hash((self.name, self.arguments))

    def __deepcopy__(self, memo: dict[int, object]) -> "Road":
        return self  # immutable

    def lane(self, index: LaneIndex) -> Lane:
        """The lane of this index; KeyError if the road has none."""
        return self.lanes[index]

    def count(self, start: str, end: str) -> int:
        """Number of parallel lanes from node `start` to node `end`; KeyError if they are not joined."""
        return self._counts[start, end]

    def beside(self, index: LaneIndex, side: int) -> LaneIndex | None:
        """The lane to the left (-1) or right (+1) that may be changed to; None without one.

        Whoever changes lanes asks here: the ego, drivers of the replica, cut-ins; SUMO's networks are built by it.
        """
        other = (*index[:2], index[2] + side)
        return other if other in self.lanes and not self.lanes[other].forbidden else None

    @cached_property
    def dead_ends(self) -> frozenset[LaneIndex]:
        """Lanes that end before the road does: no lane of a next road continues them."""
        found = set()
        for index, lane in self.lanes.items():
            node, end = index[1], lane.position(lane.length, 0.0)
            after = [other for key, other in self.lanes.items() if key[0] == node not in self.ends]
            beside = [abs(other.local_coordinates(*end)[1]) for other in after]
            if beside and min(beside) > CONTINUES * lane.width and not self.oncoming:
                found.add(index)
        return frozenset(found)

    def route(self, start: str, goal: str) -> tuple[str, ...]:
        """Nodes of the shortest path, both ends included; alphabetical among equals; () if there is none."""
        queue: deque[tuple[str, ...]] = deque([(start,)])
        seen = {start}
        while queue:
            path = queue.popleft()
            for node in sorted(self.successors.get(path[-1], ())):
                if node not in seen:
                    seen.add(node)
                    queue.append((*path, node))
                    if node == goal:
                        return queue[-1]
        return ()

    def follow(self, index: LaneIndex, route: Sequence[str], x: float, y: float) -> LaneIndex:
        """The lane to steer for at (x, y) [m]: `index`, or at its end the next one of the route (`follow_road`).

        The two-way road goes on: its next lane would be that of the oncoming traffic.
        """
        is_over = not self.oncoming and self.lanes[index].after_end(x, y)
        return self.next_lane(index, route, x, y) if is_over else index

    def next_lane(self, index: LaneIndex, route: Sequence[str], x: float, y: float) -> LaneIndex:
        """The lane that follows `index` on the way along the nodes of `route`.

        The lane id is kept onto a road with as many lanes; otherwise the lane is taken that is closest to the current
        lane's centre beside the vehicle at (x, y) [m]. Where the route does not go on past the lane's end all
        successors compete; without any, `index` stays.
        """
        start, node, i = index
        lane = self.lanes[index]
        projected = lane.position(lane.local_coordinates(x, y)[0], 0.0)

        def onto(end: str) -> tuple[float, LaneIndex]:
            keeps = self._counts[start, node] == self._counts[node, end]
            candidates = [(node, end, j) for j in ((i,) if keeps else range(self._counts[node, end]))]
            return min(((self.lanes[c].distance(*projected), c) for c in candidates), key=itemgetter(0))

        if node in route[:-1]:
            return onto(route[route.index(node) + 1])[1]
        ends = self.successors.get(node, ())
        return min(map(onto, ends), key=itemgetter(0))[1] if ends else index

    def closest_lane(self, x: float, y: float, heading: float | None = None) -> LaneIndex:
        """Index of the lane with the least `distance`, that of the heading included; the first of equals.

        highway-env's ``RoadNetwork.get_closest_lane_index``.
        """
        names: Iterable[LaneIndex] = self.lanes

        def distance(index: LaneIndex) -> float:
            return self.lanes[index].distance(x, y, heading)

        if len(self.lanes) > FEW:
            known, least = self._least_distances(x, y)
            enough = distance(known[least.argmin()])
            names = [known[place] for place in np.flatnonzero(least <= enough).tolist()]
        return min(names, key=distance)

    def lanes_near(self, x: float, y: float, reach: float) -> list[LaneIndex]:
        """The lanes of which a part may be within `reach` [m] of a place; all where there are few."""
        if len(self.lanes) <= FEW:
            return list(self.lanes)
        known, least = self._least_distances(x, y)
        return [known[place] for place in np.flatnonzero(least <= reach).tolist()]

    def _least_distances(self, x: float, y: float) -> tuple[list[LaneIndex], NDArray[np.float64]]:
        """The lanes, and the least distances that are possible [m]."""
        known, low, high = self._boxes
        # on a sine lane, whose s is measured along its axis, 7 % less
        return known, 0.9 * np.hypot(*np.maximum(0.0, np.maximum(low - (x, y), (x, y) - high)).T)

    @cached_property
    def _boxes(self) -> tuple[list[LaneIndex], NDArray[np.float64], NDArray[np.float64]]:
        """The lanes, and the corners of boxes in which they are, shape (lanes, 2) each [m]."""
        corners = []
        for lane in self.lanes.values():
            places = np.linspace(0.0, lane.length, math.ceil(lane.length / SAMPLE) + 1)
            points = np.array([lane.position(s, 0.0) for s in places.tolist()])
            corners.append((points.min(axis=0) - SAMPLE, points.max(axis=0) + SAMPLE))
        low, high = np.array(corners).swapaxes(0, 1)
        return list(self.lanes), low, high


def _graph_order(lanes: Mapping[LaneIndex, Lane]) -> list[tuple[LaneIndex, Lane]]:
    """Sorted as in highway-env's dict of dicts of lists: by first use of the start, then of the end."""
    starts: dict[str, int] = {}
    ends: dict[tuple[str, str], int] = {}
    for start, end, _ in lanes:
        starts.setdefault(start, len(starts))
        ends.setdefault((start, end), len(ends))
    return sorted(lanes.items(), key=lambda item: (starts[item[0][0]], ends[item[0][:2]], item[0][2]))


@lru_cache(maxsize=8)
def highway(lanes_count: int = 4) -> Road:
    """Parallel lanes to the east, 10 km, 30 m/s, lane i at y = 4 i."""
    return Road(
        "highway",
        {
            ("0", "1", i): StraightLane((0.0, WIDTH * i), (10_000.0, WIDTH * i), speed_limit=30.0)
            for i in range(lanes_count)
        },
        arguments=(("lanes_count", lanes_count),),
        ends=("1",),
        net_file=f"highway/highway-{lanes_count}.net.xml",
    )


@lru_cache(maxsize=8)
def two_way(road_length: float = 800.0) -> Road:
    """One lane each way: at y = 4 the own one, at y = 0 a strip with two, ("a","b",0) and ("b","a",0).

    `road_length` [m] is where highway-env's road ends; vehicles drive on beyond it, in the same lanes.
    """
    return Road(
        "two-way",
        {
            ("a", "b", 0): StraightLane((0.0, 0.0), (road_length, 0.0)),
            ("a", "b", 1): StraightLane((0.0, WIDTH), (road_length, WIDTH)),
            ("b", "a", 0): StraightLane((road_length, 0.0), (0.0, 0.0)),
        },
        arguments=(("road_length", road_length),),
        ends=("a", "b"),
        net_file="two_way/two_way.net.xml",
        oncoming=True,
    )


RING = ("se", "ex", "ee", "nx", "ne", "wx", "we", "sx")  # the ring's nodes in driving order
ARMS = ("s", "e", "n", "w")  # arms of the roundabout, likewise


@lru_cache(maxsize=8)
def roundabout() -> Road:
    """A two-lane ring of radii 20 and 24 m, driven counter-clockwise on the screen, with four arms.

    Entries and exits are sines that end 5.6 m short of the ring: highway-env's geometry is not continuous.
    """
    lanes: dict[LaneIndex, Lane] = {}
    phase = 90.0 - 24.0  # [deg] of node "se"; then arcs of 42 and 48 degrees in turn, toward falling phases
    for k, node in enumerate(RING):
        end_phase = phase - (42.0 if k % 2 == 0 else 48.0)
        # highway-env starts anew at +156 degrees with "we"; phases matter because headings are not wrapped
        first, last = (phase + 360.0, end_phase + 360.0) if node in ("we", "sx") else (phase, end_phase)
        for i, radius in enumerate((20.0, 24.0)):
            lanes[node, RING[(k + 1) % 8], i] = CircularLane(
                (0.0, 0.0), radius, math.radians(first), math.radians(last), clockwise=False
            )
        phase = end_phase

    access, period, amplitude = 170.0, 85.0, 5.0  # [m]
    sine = 0.2 * period  # [m], length of an entry or exit
    pulsation = 2 * math.pi / period
    enter: dict[str, Any] = {"amplitude": amplitude, "pulsation": pulsation, "phase": -math.pi / 2}
    leave = {**enter, "phase": -math.pi / 2 + pulsation * (period - sine)}
    for arm, name in enumerate(ARMS):  # the southern arm's coordinates, turned

        def at(x: float, y: float, quarters: int = -arm) -> Point:
            return quarter_turns((x, y), quarters)

        road_in, sine_in, ring_in = name + "er", name + "es", name + "e"
        ring_out, sine_out, road_out = name + "x", name + "xs", name + "xr"
        lanes[road_in, sine_in, 0] = StraightLane(at(2, access), at(2, period / 2))
        near, far = period / 2 - sine, period / 2
        lanes[sine_in, ring_in, 0] = SineLane(at(2 + amplitude, far), at(2 + amplitude, near), **enter)
        lanes[ring_out, sine_out, 0] = SineLane(at(-2 - amplitude, near), at(-2 - amplitude, far), **leave)
        lanes[sine_out, road_out, 0] = StraightLane(at(-2, period / 2), at(-2, access))
    ends = tuple(f"{name}xr" for name in ARMS)
    return Road("roundabout", lanes, ends=ends, net_file="roundabout/roundabout.net.xml", joined=True)


@lru_cache(maxsize=8)
def intersection() -> Road:
    """Four arms of one lane each way that meet in a square of +-11 m; 0 is south, then west, north, east.

    The east-west road has priority 3 (its left turns 2), the north-south road 1 (left turns 0).
    """
    turn, half = 9.0, 11.0  # [m], radius of a right turn; half the square
    access = 100.0  # [m]
    lanes: dict[LaneIndex, Lane] = {}
    for corner in range(4):

        def at(x: float, y: float, quarters: int = corner) -> Point:
            return quarter_turns((x, y), quarters)

        angle, rank = math.radians(90 * corner), 3 if corner % 2 else 1
        rule: dict[str, Any] = {"priority": rank, "speed_limit": 10.0}
        left_rule: dict[str, Any] = {**rule, "priority": rank - 1}
        entry = f"ir{corner}"
        right, left, ahead = (f"il{(corner + turned) % 4}" for turned in (-1, 1, 2))
        quarters = angle + math.pi, angle + math.radians(270)
        to_left = CircularLane(at(-half, half), turn + WIDTH, angle, angle - math.pi / 2, False, **left_rule)
        lanes[f"o{corner}", entry, 0] = StraightLane(at(2, access + half), at(2, half), **rule)
        lanes[entry, right, 0] = CircularLane(at(half, half), turn, *quarters, **rule)
        lanes[entry, left, 0] = to_left
        lanes[entry, ahead, 0] = StraightLane(at(2, half), at(2, -half), **rule)
        # An exit carries the priority of the corner right of it, as in highway-env.
        lanes[right, f"o{(corner - 1) % 4}", 0] = StraightLane(at(half, 2), at(access + half, 2), **rule)
    return Road(
        "intersection",
        lanes,
        ends=("o0", "o1", "o2", "o3"),
        net_file="intersection/intersection.net.xml",
        clears_exits=True,
        joined=True,
        regulated=True,
        turned_by_matrix=True,
    )


@lru_cache(maxsize=8)
def u_turn() -> Road:
    """Two lanes 128 m to the east, a half circle to the left (radii 20 and 24 m), and back to the west."""
    length, radius = 128.0, 20.0
    lanes: dict[LaneIndex, Lane] = {}
    for i, y in enumerate((WIDTH, 0.0)):
        lanes["c", "d", i] = StraightLane((length, y), (0.0, y))
    for i in range(2):
        lanes["b", "c", i] = CircularLane(
            (length, WIDTH + radius), radius + WIDTH * i, math.pi / 2, -math.pi / 2, clockwise=False
        )
        y = 2 * radius + WIDTH * (1 + i)
        lanes["a", "b", i] = StraightLane((0.0, y), (length, y))
    return Road("u-turn", lanes, ends=("d",), net_file="u_turn/u_turn.net.xml", joined=True)


@lru_cache(maxsize=8)
def merge() -> Road:
    """Two lanes to the east, 460 m, and from 230 to 310 m a third one right of them, which a ramp leads to.

    Nobody may change to the ramp's lanes, and an obstacle stands at the end of the third lane.
    """
    # [m] along x: of the sine, of the third lane, of the road
    start, sine, end, last = 150.0, 230.0, 310.0, 460.0
    amplitude, y = 3.25, 2 * WIDTH  # [m] of the sine; of the third lane
    curve: dict[str, Any] = {
        "amplitude": amplitude,
        "pulsation": math.pi / (sine - start),
        "phase": math.pi / 2,
    }
    lanes: dict[LaneIndex, Lane] = {}
    for i in range(2):
        for road, (x, to) in {
            ("a", "b"): (0.0, sine),
            ("b", "c"): (sine, end),
            ("c", "d"): (end, last),
        }.items():
            lanes[*road, i] = StraightLane((x, WIDTH * i), (to, WIDTH * i))
    far = y + 2 * amplitude
    lanes["j", "k", 0] = StraightLane((0.0, far), (start, far), forbidden=True)
    lanes["k", "b", 0] = SineLane((start, y + amplitude), (sine, y + amplitude), **curve, forbidden=True)
    lanes["b", "c", 2] = StraightLane((sine, y), (end, y), forbidden=True)
    return Road(
        "merge", lanes, obstacles=((end, y),), ends=("d",), net_file="merge/merge.net.xml", joined=True
    )


@lru_cache(maxsize=8)
def exit_road(lanes_count: int = 6) -> Road:
    """Lanes 1 km to the east, lane i with a limit of 26 - 3.4 i m/s; from 400 to 500 m one more, and then a bend."""
    lanes: dict[LaneIndex, Lane] = {}
    for start, end, x, to in (("0", "1", 0.0, 400.0), ("1", "2", 400.0, 500.0), ("2", "3", 500.0, 1000.0)):
        for i in range(lanes_count + (start == "1")):
            lanes[start, end, i] = StraightLane((x, WIDTH * i), (to, WIDTH * i), speed_limit=26.0 - 3.4 * i)
    center, phases = (500.0, WIDTH * lanes_count + 150.0), (3 * math.pi / 2, 2 * math.pi)
    lanes["2", "exit", 0] = CircularLane(center, 150.0, *phases, forbidden=True)
    arguments, net_file = (("lanes_count", lanes_count),), f"exit/exit-{lanes_count}.net.xml"
    return Road("exit", lanes, arguments, ends=("3", "exit"), net_file=net_file, joined=True)


ROADS: Mapping[str, Callable[..., Road]] = {
    "highway": highway,
    "two-way": two_way,
    "roundabout": roundabout,
    "intersection": intersection,
    "u-turn": u_turn,
    "merge": merge,
    "exit": exit_road,
}


def is_shipped(road: Road) -> bool:
    """Whether its name and its arguments stand for this road."""
    return road.name in ROADS and ROADS[road.name](**dict(road.arguments)) == road


def road(name: str, **arguments: float) -> Road:
    """The road of this name; highway and exit have a `lanes_count`, the two-way road a `road_length` [m].

    Raises:
        ValueError: unknown name, or an argument that makes no road.
    """
    if name not in ROADS:
        raise ValueError(f"unknown road {name!r}; choose from {', '.join(ROADS)}")
    return ROADS[name](**arguments)
