"""Input for netconvert: nodes, edges and connections of each task, derived from `sumo_env.networks.roads`.

Everything here is in highway-env's coordinates (y down); `Plan.write` turns y over. Straight ends are
longer than highway-env's, where vehicles keep driving along the extrapolated lane: here they need a lane
to do so.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from sumo_env.networks import roads
from sumo_env.networks.lanes import WIDTH, CircularLane, Lane, Point, SineLane
from sumo_env.networks.roads import LaneIndex, Road

Line = tuple[Point, ...]

GAP = 0.12  # [m] that a plain junction takes out of the road; SUMO needs 0.1. See docs/developers/architecture.md
ARC_STEP = math.radians(1.0)  # chords of 1 degree stay within 1 mm of a circle of 24 m
SINE_STEP = 0.5  # [m]
OVERHANG = 1.1  # [m] that the merge's third lane is longer, so that the obstacle at its end stands on it
NOBODY = "custom1"  # SUMO has no word for it: a class of which there are no vehicles
LANES_COUNTS = (1, 2, 3, 4, 5, 6)  # highways that are built


# attributes of an XML element, and lists of elements inside it; lengths in m, lines as points
Item = dict[str, Any]


@dataclass(frozen=True)
class Plan:
    """One SUMO network before it is built: netconvert's plain XML. `roundabout` lists the edges of the ring."""

    name: str  # folder/stem of its files
    road: Road
    nodes: tuple[Item, ...]
    edges: tuple[Item, ...]
    connections: tuple[Item, ...] = ()
    roundabout: tuple[str, ...] = ()

    def write(self, folder: Path) -> list[Path]:
        """Write <name>.nod.xml, .edg.xml and .con.xml below `folder`; returns their paths in this order."""
        sheets = {"node": self.nodes, "edge": self.edges, "connection": self.connections}
        paths = []
        for tag, items in sheets.items():
            tree = ElementTree.Element(f"{tag}s")
            for item in items:
                _add(tree, tag, item)
            if tag == "edge" and self.roundabout:
                ring = [edge.split("-")[0] for edge in self.roundabout]
                _add(tree, "roundabout", {"nodes": " ".join(ring), "edges": " ".join(self.roundabout)})
            path = folder / f"{self.name}.{tag[:3]}.xml"
            path.parent.mkdir(parents=True, exist_ok=True)
            ElementTree.indent(tree)
            path.write_bytes(ElementTree.tostring(tree) + b"\n")
            paths.append(path)
        return paths


def _add(parent: ElementTree.Element, tag: str, item: Item) -> None:
    own = {key: _text(value) for key, value in item.items() if value != () and not isinstance(value, list)}
    element = ElementTree.SubElement(parent, tag, own)
    for key, value in item.items():
        for inner in value if isinstance(value, list) else ():
            _add(element, key, inner)


def _text(value: str | int | float | Line) -> str:
    if isinstance(value, float):
        return f"{round(value, 4) + 0.0:.4f}"  # + 0.0 makes 0.0 of -0.0
    return " ".join(f"{_text(x)},{_text(-y)}" for x, y in value) if isinstance(value, tuple) else str(value)


def _place(id: str, at: Point, type: str = "priority", shape: Line = ()) -> Item:
    """A junction; `shape` is its outline, netconvert's own without one."""
    return {"id": id, "x": at[0], "y": -at[1], "type": type, "shape": shape}


def _way(start: str, end: str, lanes: int, shape: Line, speed: float, priority: int = 1) -> Item:
    """An edge of parallel lanes whose middle is `shape`; `speed` [m/s]."""
    ends = {"from": start, "to": end, "id": f"{start}-{end}"}
    size = {"numLanes": lanes, "width": WIDTH, "speed": speed, "priority": priority}
    return {**ends, **size, "spreadType": "center", "shape": shape}


def _connection(start: str, end: str, from_lane: int, to_lane: int, shape: Line) -> Item:
    """From a lane of an edge onto a lane of the next one (SUMO's lane numbers, 0 is the right lane).

    contPos 0: no internal junction, which would split a left turn in two lanes with a stop between them. visibility
    200: by default SUMO's drivers slow down before a minor connection until they are 4.5 m from it, in order to see
    whether somebody comes; highway-env's see everywhere.
    """
    ends = {"from": start, "to": end, "fromLane": from_lane, "toLane": to_lane}
    return {**ends, "shape": shape, "contPos": "0", "visibility": "200"}


def sample(lane: Lane, start: float, end: float, lat: float = 0.0) -> Line:
    """Points `lat` [m] right of the centre from s = `start` to `end` [m], chords within 1 mm of the curve."""
    if isinstance(lane, CircularLane):
        n = math.ceil((end - start) / lane.radius / ARC_STEP)
    elif isinstance(lane, SineLane):
        n = math.ceil((end - start) / SINE_STEP)
    else:
        n = 1
    return tuple(lane.position(start + (end - start) * k / n, lat) for k in range(n + 1))


def _scale(road: Road, index: LaneIndex) -> float:
    """Length of a lane over the length of the middle of its road."""
    lane, left = road.lane(index), road.lane((*index[:2], 0))
    if isinstance(lane, CircularLane) and isinstance(left, CircularLane):
        return lane.radius / (left.radius + WIDTH * (road.count(*index[:2]) - 1) / 2)
    return 1.0


def _edge(road: Road, start: str, end: str, before: float, after: float, priority: int = 1) -> Item:
    """highway-env's road from `start` to `end`, longer by `before` and `after` [m] (shorter if negative)."""
    n = road.count(start, end)
    left = road.lane((start, end, 0))
    middle = WIDTH * (n - 1) / 2
    scale = _scale(road, (start, end, 0))  # trimmed by angle, so that the lanes of a bend end side by side
    shape = sample(left, -before * scale, left.length + after * scale, middle)
    way = _way(start, end, n, shape, left.speed_limit, priority)
    lanes: list[Item] = []  # what is said of single lanes
    for i in range(n):
        if (limit := road.lane((start, end, i)).speed_limit) != left.speed_limit:
            lanes.append({"index": str(n - 1 - i), "speed": limit})
        for side, key in ((-1, "changeLeft"), (1, "changeRight")):
            if 0 <= i + side < n and road.beside((start, end, i), side) is None:
                lanes.append({"index": str(n - 1 - i), key: NOBODY})
    return {**way, "lane": lanes} if lanes else way


def bow(start: Point, direction: float, end: Point, end_direction: float) -> Line:
    """A smooth curve (cubic Bezier) between two points with given headings [rad]."""
    reach = math.dist(start, end) / 3
    if reach < GAP:
        return start, end
    p1 = (start[0] + reach * math.cos(direction), start[1] + reach * math.sin(direction))
    p2 = (end[0] - reach * math.cos(end_direction), end[1] - reach * math.sin(end_direction))
    points = []
    for t in (k / 16 for k in range(17)):
        a, b, c, d = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3
        x, y = (a * start[i] + b * p1[i] + c * p2[i] + d * end[i] for i in (0, 1))
        points.append((x, y))
    return tuple(points)


def _join(road: Road, first: LaneIndex, second: LaneIndex, trim: tuple[float, float]) -> Item:
    """From the end of lane `first` (less `trim[0]` m) onto the start of lane `second` (plus `trim[1]` m)."""
    a, b = road.lane(first), road.lane(second)
    s_a, s_b = a.length - trim[0] * _scale(road, first), trim[1] * _scale(road, second)
    shape = bow(a.position(s_a, 0.0), a.heading_at(s_a), b.position(s_b, 0.0), b.heading_at(s_b))
    n_a, n_b = road.count(*first[:2]), road.count(*second[:2])
    edges = f"{first[0]}-{first[1]}", f"{second[0]}-{second[1]}"
    return _connection(*edges, n_a - 1 - first[2], n_b - 1 - second[2], shape)


def highway(lanes_count: int = 4) -> Plan:
    """Lanes from x = -500 m to 11 km."""
    road = roads.highway(lanes_count)
    y = WIDTH * (lanes_count - 1) / 2
    return Plan(
        f"highway/highway-{lanes_count}",
        road,
        (_place("0", (-500.0, y), "dead_end"), _place("1", (11_000.0, y), "dead_end")),
        (_edge(road, "0", "1", 500.0, 1000.0),),
    )


def two_way() -> Plan:
    """Two edges from x = -700 to 1500 m, each the other's `neigh`, so that overtaking works; any road length.

    highway-env's third lane, ("a","b",0), is the oncoming one driven the wrong way: in SUMO the edge "b-a".
    """
    road = roads.two_way(800.0)
    ends = {"a": (-700.0, WIDTH / 2), "b": (1500.0, WIDTH / 2)}
    own = _way("a", "b", 1, ((-700.0, WIDTH), (1500.0, WIDTH)), 20.0)
    oncoming = _way("b", "a", 1, ((1500.0, 0.0), (-700.0, 0.0)), 20.0)
    own["lane"] = [{"index": "0", "neigh": [{"lane": "b-a_0"}]}]
    oncoming["lane"] = [{"index": "0", "neigh": [{"lane": "a-b_0"}]}]
    nodes = tuple(_place(name, at, "dead_end") for name, at in ends.items())
    return Plan("two_way/two_way", road, nodes, (own, oncoming))


def _across(road: Road, start: str, end: str, s: float) -> tuple[Point, Point]:
    """Left and right border of a road at `s` [m along its middle]."""
    n = road.count(start, end)
    left = road.lane((start, end, 0))
    s *= _scale(road, (start, end, 0))
    return left.position(s, -WIDTH / 2), left.position(s, WIDTH * (n - 1) + WIDTH / 2)


def _joint(road: Road, way: tuple[str, str], name: str, s: float, spur: Line = ()) -> Item:
    """A short junction across a road at `s` [m along its middle], which goes on with as many lanes.

    spur: corners that its outline has beside, on the right.
    """
    (left_in, right_in), (left_out, right_out) = (_across(road, *way, s + by) for by in (-GAP / 2, GAP / 2))
    left, middle = (*way, 0), WIDTH * (road.count(*way) - 1) / 2
    at = road.lane(left).position(s * _scale(road, left), middle)
    return _place(name, at, shape=(left_in, left_out, right_out, *spur, right_in))


def _node(road: Road, before: tuple[str, str], branch: tuple[str, str] | None = None) -> Item:
    """The joint at the end of `before`.

    A `branch` is a road right of it that ends (or starts) a few metres off: the outline gets a spur that
    reaches it. Edges end where they meet the outline, and netconvert would stretch one that does not meet
    it.
    """
    spur: Line = ()
    if branch is not None:
        touch = 0.01  # [m] of overlap, so that rounding cannot part them
        ends = branch[1] == before[1]
        left, right = _across(road, *branch, road.lane((*branch, 0)).length - touch if ends else touch)
        spur = (right, left) if ends else (left, right)
    length = road.lane((*before, 0)).length / _scale(road, (*before, 0))
    return _joint(road, before, before[1], length, spur)


def u_turn() -> Plan:
    """One way of three edges, from 100 m before highway-env's start to 400 m beyond its end."""
    road = roads.u_turn()
    g = GAP / 2
    edges = (
        _edge(road, "a", "b", 100.0, -g),
        _edge(road, "b", "c", -g, -g),
        _edge(road, "c", "d", -g, 400.0),
    )
    nodes = (
        _place("a", edges[0]["shape"][0], "dead_end"),
        _node(road, ("a", "b")),
        _node(road, ("b", "c")),
        _place("d", edges[2]["shape"][-1], "dead_end"),
    )
    joints = tuple(_join(road, (a, b, i), (b, c, i), (g, g)) for a, b, c in ("abc", "bcd") for i in range(2))
    return Plan("u_turn/u_turn", road, nodes, edges, joints)


def roundabout() -> Plan:
    """The ring and its arms. Where highway-env's lanes jump by 5.6 m, a bow in the junction leads across."""
    road = roads.roundabout()
    g = GAP / 2
    ring = tuple(pairwise((*roads.RING, roads.RING[0])))
    edges = [_edge(road, a, b, -g, -g, priority=2) for a, b in ring]
    nodes, joints = [], []
    for k, (a, b) in enumerate(ring):
        c = ring[(k + 1) % len(ring)][1]
        branch = (b[0] + "es", b) if b[1] == "e" else (b, b[0] + "xs")
        nodes.append(_node(road, (a, b), branch))
        joints += [_join(road, (a, b, i), (b, c, i), (g, g)) for i in range(2)]
    for arm in roads.ARMS:
        road_in, sine_in, ring_in = arm + "er", arm + "es", arm + "e"
        ring_out, sine_out, road_out = arm + "x", arm + "xs", arm + "xr"
        before = road_in, sine_in, 0
        edges += [
            _edge(road, road_in, sine_in, 100.0, -g),
            _edge(road, sine_in, ring_in, -g, 0.0),
            _edge(road, ring_out, sine_out, 0.0, -g),
            _edge(road, sine_out, road_out, -g, 400.0),
        ]
        nodes += [
            _place(road_in, edges[-4]["shape"][0], "dead_end"),
            _node(road, (road_in, sine_in)),
            _node(road, (ring_out, sine_out)),
            _place(road_out, edges[-1]["shape"][-1], "dead_end"),
        ]
        after = roads.RING[roads.RING.index(ring_in) + 1]
        last = roads.RING[roads.RING.index(ring_out) - 1]
        joints += [
            _join(road, before, (sine_in, ring_in, 0), (g, g)),
            _join(road, (sine_in, ring_in, 0), (ring_in, after, 1), (0.0, g)),
            _join(road, (last, ring_out, 1), (ring_out, sine_out, 0), (g, 0.0)),
            # highway-env's cars steer from the inner lane straight to the exit, across the outer one
            _join(road, (last, ring_out, 0), (ring_out, sine_out, 0), (g, 0.0)),
            _join(road, (ring_out, sine_out, 0), (sine_out, road_out, 0), (g, g)),
        ]
    circle = tuple(f"{a}-{b}" for a, b in ring)
    return Plan("roundabout/roundabout", road, tuple(nodes), tuple(edges), tuple(joints), circle)


def intersection() -> Plan:
    """Four arms and the square of +-11 m, in which SUMO's internal lanes are highway-env's lanes."""
    road = roads.intersection()
    square = ((-11.0, -11.0), (11.0, -11.0), (11.0, 11.0), (-11.0, 11.0))
    nodes = [_place("x", (0.0, 0.0), "priority", square)]
    edges, joints = [], []
    for k in range(4):
        priority = 10 if k % 2 else 1
        entry = _edge(road, f"o{k}", f"ir{k}", 50.0, 0.0, priority)
        leave = _edge(road, f"il{k}", f"o{k}", 0.0, 400.0, priority)
        start, end = f"start{k}", f"end{k}"
        nodes += [_place(start, entry["shape"][0], "dead_end"), _place(end, leave["shape"][-1], "dead_end")]
        edges += [{**entry, "from": start, "to": "x"}, {**leave, "from": "x", "to": end}]
        for j in range(4):
            if j != k:
                lane = road.lane((f"ir{k}", f"il{j}", 0))
                turn = sample(lane, 0.0, lane.length)
                joints.append(_connection(f"o{k}-ir{k}", f"il{j}-o{j}", 0, 0, turn))
    return Plan("intersection/intersection", road, tuple(nodes), tuple(edges), tuple(joints))


def merge() -> Plan:
    """Two lanes, and a ramp that becomes a third one, which ends; 100 m longer before and 400 m longer behind."""
    road = roads.merge()
    g, o = GAP / 2, OVERHANG
    edges = (
        _edge(road, "a", "b", 100.0, -g),
        _edge(road, "b", "c", -g, o - g),
        _edge(road, "c", "d", -o - g, 400.0),
        _edge(road, "j", "k", 100.0, -g),
        _edge(road, "k", "b", -g, -g),
    )
    nodes = (
        _place("a", edges[0]["shape"][0], "dead_end"),
        _place("j", edges[3]["shape"][0], "dead_end"),
        _node(road, ("j", "k")),
        _joint(road, ("b", "c"), "b", 0.0),
        _joint(road, ("b", "c"), "c", road.lane(("b", "c", 0)).length + o),
        _place("d", edges[2]["shape"][-1], "dead_end"),
    )
    joints = [
        *(_join(road, ("a", "b", i), ("b", "c", i), (g, g)) for i in range(2)),
        *(_join(road, ("b", "c", i), ("c", "d", i), (g - o, g + o)) for i in range(2)),
        _join(road, ("j", "k", 0), ("k", "b", 0), (g, g)),
        _join(road, ("k", "b", 0), ("b", "c", 2), (g, g)),
    ]
    return Plan("merge/merge", road, nodes, edges, tuple(joints))


def exit_road(lanes_count: int = 6) -> Plan:
    """Lanes from x = -100 m to 11 km, and an exit whose bend is 200 m longer (half a turn is the most there can be)."""
    road = roads.exit_road(lanes_count)
    g = GAP / 2
    edges = (
        _edge(road, "0", "1", 100.0, -g),
        _edge(road, "1", "2", -g, -g),
        _edge(road, "2", "3", -g, 10_000.0),
        _edge(road, "2", "exit", -g, 200.0),
    )
    nodes = (
        _place("0", edges[0]["shape"][0], "dead_end"),
        _joint(road, ("1", "2"), "1", 0.0),
        _joint(road, ("1", "2"), "2", road.lane(("1", "2", 0)).length),
        *(_place(edge["to"], edge["shape"][-1], "dead_end") for edge in edges[2:]),
    )
    lanes = range(lanes_count)
    leave = _join(road, ("1", "2", lanes_count), ("2", "exit", 0), (g, g))
    joints = [_join(road, (a, b, i), (b, c, i), (g, g)) for a, b, c in ("012", "123") for i in lanes]
    # netconvert's own is the mean of the limits before and behind
    joints.append({**leave, "speed": road.lane(("2", "exit", 0)).speed_limit})
    return Plan(f"exit/exit-{lanes_count}", road, nodes, edges, tuple(joints))


def all_plans() -> tuple[Plan, ...]:
    """Every network that is shipped; highway and exit once for each number of lanes."""
    return (
        *map(highway, LANES_COUNTS),
        *(two_way(), roundabout(), intersection(), u_turn(), merge()),
        *map(exit_road, LANES_COUNTS[1:]),
    )
