"""Any SUMO network as a road: its lanes, junctions and speed limits, read with sumolib.

An edge E becomes the road from node "E:from" to node "E:to", with lane 0 on the left as in highway-env, and the
connections through a junction onto the edge F become the road from "E:to" to "F:from". Those are the lanes for
passenger cars; lanes for buses, bicycles and others alone are the road from "E/closed:from" to "E/closed:to".
`lane("E", 0)` is the index of a lane.
"""

import gzip
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import count, pairwise, product
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary
from xml.etree import ElementTree

from sumo_env.networks.lanes import Lane, Point, PolyLane
from sumo_env.networks.mapping import Network, SumoLane, joints_of, read_net, sumo_lanes_of
from sumo_env.networks.meeting import Meeting
from sumo_env.networks.roads import LaneIndex, Road

Shape = tuple[Point, ...]

CAR = "passenger"  # SUMO's class of the ego, and of all vehicles without another one
CLOSED = "/closed"  # after the name of an edge: its lanes on which no cars drive
MINOR = ("m", "s", "w")  # SUMO's states of a way through a junction on which one gives way or stops
TWO_WHEELS = {"bicycle", "moped", "motorcycle"}
OTHERS = TWO_WHEELS | {"bus", "coach", "delivery", "emergency", "taxi", "trailer", "truck"}
CLOSE = 0.05  # [m] points of a lane that are nearer to each other count as one: between them is no direction
# [m] in lanes shorter than this, SUMO's length is taken for the drawn one: their ratio means nothing
SHORT = 2.0


def lane(edge: str, number: int = 0) -> LaneIndex:
    """Index of a lane of one of SUMO's edges, counted from the left."""
    return f"{edge}:from", f"{edge}:to", number


def is_file(name: str) -> bool:
    """Whether the name of a road is that of a file of SUMO's."""
    return os.path.isabs(name) or name.endswith((".xml", ".xml.gz"))


def network(net_file: str | Path) -> Network:
    """The network of a file (.net.xml, .net.xml.gz); it is read again when it has changed.

    Raises:
        ValueError: there is no such file, or it is no network with lanes inside its junctions.
    """
    path = Path(os.path.realpath(net_file))
    if not path.is_file():
        raise ValueError(f"there is no SUMO network {path}")
    try:
        return _known(path, path.stat().st_mtime_ns)
    except Exception as error:  # of the XML parser, of sumolib, or of lanes that do not fit each other
        if str(path) in str(error):
            raise
        raise ValueError(f"{path} cannot be read as a SUMO network: {error}") from error


def lanes_for(network: Network, edge: str, vehicles: str = CAR) -> list[LaneIndex]:
    """Lanes of an edge on which vehicles of a class may drive, from the left; all that there are for the class ""."""
    found = []
    for name in (edge, edge + CLOSED):
        for number in count():
            if (index := lane(name, number)) not in network.lanes:
                break
            if not vehicles or vehicles in network.lanes[index].classes:
                found.append(index)
    return found


def check_route(network: Network, name: str, way: Sequence[str], vehicles: str = CAR) -> None:
    """That vehicles of a class can drive a route.

    Raises:
        ValueError: the network has no such edge for them, or two edges are not connected; the message names them.
    """
    drivers = "passenger cars" if vehicles in ("", CAR) else f"vehicles of class {vehicles!r}"
    if not all(isinstance(edge, str) for edge in way):
        raise ValueError(f"route {name!r} must be names of edges, not {way!r}")
    lanes = [lanes_for(network, edge, vehicles) for edge in way]
    for edge, own in zip(way, lanes, strict=True):
        if not own:
            raise ValueError(f"route {name!r}: {network.road.name} has no edge {edge!r} for {drivers}")
    for (one, own), (other, after) in pairwise(zip(way, lanes, strict=True)):
        if not any(_onward(network, index) & set(after) for index in own):
            raise ValueError(f"route {name!r}: no connection leads from edge {one!r} to edge {other!r}")


def check_trip(network: Network, start: str, end: str, vehicles: str = CAR) -> None:
    """That vehicles of a class find a way between two edges.

    Raises:
        ValueError: the network has no such edge for them, or no way; the message names the edges.
    """
    for edge in (start, end):
        check_route(network, f"{start} to {end}", (edge,), vehicles)
    ways = product(*(lanes_for(network, edge, vehicles) for edge in (start, end)))
    if start != end and not any(network.road.route(first[1], last[0]) for first, last in ways):
        raise ValueError(f"no way leads from edge {start!r} to edge {end!r}")


def _onward(network: Network, index: LaneIndex) -> set[LaneIndex]:
    """The lanes beyond the next junction to which a lane leads."""
    found = set()
    for name in network.lanes[index].following:
        while name.startswith(":"):
            name = next(iter(network.sumo_lanes[name].following), "")
        found.add(network.indices.get(name, index))
    return found - {index}


_in_use: WeakValueDictionary[tuple[Path, int], Network] = WeakValueDictionary()


@lru_cache(maxsize=4)
def _known(path: Path, changed: int) -> Network:
    """The network of a file that was changed last at a time, which is read unless somebody has it."""
    if (found := _in_use.get((path, changed))) is None:
        found = _in_use[path, changed] = _read(path)
    return found


def _read(path: Path) -> Network:
    net, left_hand = read_net(path), _is_left_hand(path)
    sumo_lanes = {name: _to_scale(found) for name, found in sumo_lanes_of(net).items()}
    ordinary = [edge for edge in net.getEdges(withInternal=False) if not edge.isSpecial()]
    drivers = _drivers(sumo_lanes[part.getID()] for edge in ordinary for part in edge.getLanes())
    lanes: dict[LaneIndex, Lane] = {}
    first: dict[LaneIndex, SumoLane] = {}  # SUMO's lane where each begins
    stops: dict[LaneIndex, tuple[tuple[str, int], ...]] = {}
    indices: dict[str, LaneIndex] = {}

    def add(index: LaneIndex, parts: list[Any], before: Shape = (), after: Shape = ()) -> None:
        own = [point for part in parts for point in sumo_lanes[part.getID()].shape]
        points = _distinct([*before[-1:], *own, *after[:1]])
        if len(points) == 1:
            points = _stub(points[0], before, after)
        lanes[index] = PolyLane(tuple(points), width=parts[0].getWidth(), speed_limit=parts[0].getSpeed())
        first[index] = sumo_lanes[parts[0].getID()]
        indices.update((part.getID(), index) for part in parts)

    def road_of(part: Any) -> str:
        """Name of the road that a lane is part of; "" where nobody drives."""
        classes, edge = sumo_lanes[part.getID()].classes, part.getEdge()
        if edge.isSpecial() or not classes & drivers:
            return ""
        name: str = edge.getID()
        return name if CAR in classes else name + CLOSED

    for edge in net.getEdges(withInternal=False):
        own: dict[str, list[Any]] = {}
        for part in edge.getLanes() if left_hand else reversed(edge.getLanes()):
            own.setdefault(road_of(part), []).append(part)
        own.pop("", None)
        for name, parts in own.items():
            gives_way = all(joint.getState() in MINOR for part in parts for joint in joints_of(part))
            for number, part in enumerate(parts):
                add(lane(name, number), [part])
                lights = _lights(part)
                if lights or (gives_way and joints_of(part)):
                    stops[lane(name, number)] = lights
            joints: dict[str, int] = {}
            for part in parts:
                for joint in joints_of(part):
                    after, inside = joint.getToLane(), joint.getViaLaneID()
                    goal = road_of(after)
                    if not goal:
                        continue
                    within = []
                    while inside.startswith(":"):  # a long way through a junction is made of several lanes
                        within.append(net.getLane(inside))
                        inside = sumo_lanes[inside].following[0]
                    if not within:
                        raise ValueError(
                            f"{path} has no lanes inside its junctions (from edge {name!r} to edge {goal!r}): make it "
                            "without --no-internal-links"
                        )
                    place = joints[goal] = joints.get(goal, -1) + 1
                    shapes = [sumo_lanes[end.getID()].shape for end in (part, after)]
                    add((f"{name}:to", f"{goal}:from", place), within, *shapes)
    if not sumo_lanes:
        raise ValueError(f"{path} has no edges: is it a SUMO network (.net.xml)?")
    if not lanes:
        raise ValueError(f"{path} has no lane for vehicles")
    road = Road(path.name, lanes, stops=stops)
    return Network(road, path, {}, first, indices, sumo_lanes, Meeting(net, sumo_lanes))


def _drivers(ordinary: Iterable[SumoLane]) -> set[str]:
    """Classes of the vehicles whose lanes count: cars and their like; where no cars drive, trains and ships."""
    here = {name for found in ordinary for name in found.classes}
    return OTHERS | {CAR} if CAR in here else here - {"pedestrian"}


def _lights(part: Any) -> tuple[tuple[str, int], ...]:
    """See `Road.stops`."""
    joints = [joint for joint in joints_of(part) if joint.getTLSID()]
    return tuple(sorted({(joint.getTLSID(), int(joint.getTLLinkIndex())) for joint in joints}))


def _to_scale(found: SumoLane) -> SumoLane:
    """With SUMO's length as the drawn length of a short lane, because their ratio is meaningless there."""
    return replace(found, drawn=found.length) if min(found.length, found.drawn) < SHORT else found


def _distinct(points: Sequence[Point]) -> list[Point]:
    """The points of a lane without those that coincide with others; the last one is kept."""
    kept = [points[0]]
    for point in points[1:]:
        if math.dist(kept[-1], point) >= CLOSE:
            kept.append(point)
    while kept and math.dist(kept[-1], points[-1]) < CLOSE:
        kept.pop()
    return [*kept, points[-1]]


def _stub(point: Point, before: Shape, after: Shape) -> list[Point]:
    """A lane without a length (junctions without a gap): a short line with the direction of the lane beside it."""
    pieces = (*reversed([*pairwise(before)]), *pairwise(after), ((0.0, 0.0), (1.0, 0.0)))
    (x0, y0), (x1, y1) = next(piece for piece in pieces if math.dist(*piece) >= CLOSE)
    scale = CLOSE / math.hypot(x1 - x0, y1 - y0)
    return [point, (point[0] + scale * (x1 - x0), point[1] + scale * (y1 - y0))]


def _is_left_hand(path: Path) -> bool:
    """Whether vehicles keep to the left: then SUMO counts lanes from the left, as highway-env does."""
    with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as opened:
        _, root = next(ElementTree.iterparse(opened, ("start",)))
    return root.get("lefthand", "0") in ("1", "true", "True")
