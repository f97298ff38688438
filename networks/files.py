"""Any SUMO network as a road: its lanes, junctions and speed limits, read with sumolib.

An edge E becomes the road from node "E:from" to node "E:to", with lane 0 on the left as in highway-env, and the
connections through a junction onto the edge F become the road from "E:to" to "F:from". Only lanes for passenger cars
count. `lane("E", 0)` is the index of a lane.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sumo_env.networks.lanes import Lane, Point, PolyLane
from sumo_env.networks.mapping import Network, SumoLane, sumo_lanes_of
from sumo_env.networks.roads import LaneIndex, Road

Routes = tuple[tuple[str, tuple[str, ...]], ...]  # (name, SUMO's edges)


def lane(edge: str, number: int = 0) -> LaneIndex:
    """Index of a lane of one of SUMO's edges, counted from the left."""
    return f"{edge}:from", f"{edge}:to", number


def network(net_file: str | Path, routes: Routes = ()) -> Network:
    """The network of a file (.net.xml), with named routes; it is read again when it has changed.

    Raises:
        ValueError: there is no such file, it is no network with lanes inside its junctions, or a route leads over
            edges that it does not have or that are not connected.
    """
    path = Path(net_file).resolve()
    if not path.is_file():
        raise ValueError(f"there is no SUMO network {path}")
    return _read(path, path.stat().st_mtime_ns, routes)


@lru_cache(maxsize=16)
def _read(path: Path, changed: int, routes: Routes) -> Network:
    from sumolib.net import readNet

    try:
        net = readNet(str(path), withInternal=True)
        sumo_lanes = sumo_lanes_of(net)
    except Exception as error:  # of the XML parser, or whatever sumolib stumbles over
        raise ValueError(f"{path} cannot be read as a SUMO network: {error}") from error
    lanes: dict[LaneIndex, Lane] = {}
    first: dict[LaneIndex, SumoLane] = {}  # SUMO's lane where each begins
    indices: dict[str, LaneIndex] = {}

    def add(index: LaneIndex, parts: list[Any], points: list[Point]) -> None:
        points = [points[0], *(b for a, b in pairwise(points) if a != b)]
        lanes[index] = PolyLane(tuple(points), width=parts[0].getWidth(), speed_limit=parts[0].getSpeed())
        first[index] = sumo_lanes[parts[0].getID()]
        indices.update((part.getID(), index) for part in parts)

    edges = {edge.getID(): edge for edge in net.getEdges(withInternal=False) if not edge.isSpecial()}
    for name, edge in edges.items():
        own = [part for part in reversed(edge.getLanes()) if part.allows("passenger")]
        for number, part in enumerate(own):
            add(lane(name, number), [part], list(sumo_lanes[part.getID()].shape))
        joints: dict[str, int] = {}
        for part in own:
            for joint in part.getOutgoing():
                after, inside = joint.getToLane(), joint.getViaLaneID()
                if after.getEdge().getID() not in edges or not after.allows("passenger"):
                    continue
                parts = []
                while inside.startswith(":"):  # a long way through a junction is made of several lanes
                    parts.append(net.getLane(inside))
                    (inside,) = sumo_lanes[inside].following
                if not parts:
                    raise ValueError(f"{path} has no lanes inside its junctions (--no-internal-links?)")
                ends = [sumo_lanes[part.getID()].shape[-1], sumo_lanes[after.getID()].shape[0]]
                points = [p for inner in parts for p in sumo_lanes[inner.getID()].shape]
                goal = after.getEdge().getID()
                number = joints[goal] = joints.get(goal, -1) + 1
                add((f"{name}:to", f"{goal}:from", number), parts, [ends[0], *points, ends[1]])
    if not lanes:
        raise ValueError(f"{path} has no lane for passenger cars")
    for name, way in routes:
        for edge in way:
            if lane(edge) not in lanes:
                raise ValueError(f"route {name!r} leads over edge {edge!r}, which {path.name} does not have")
        for one, other in pairwise(way):
            if (f"{one}:to", f"{other}:from", 0) not in lanes:
                raise ValueError(f"route {name!r}: no connection leads from edge {one!r} to edge {other!r}")
    ways = {name: tuple(f"{edge}:{end}" for edge in way for end in ("from", "to")) for name, way in routes}
    return Network(
        path.name,
        Road(path.name, lanes, ways),
        path,
        MappingProxyType(dict(routes)),
        MappingProxyType(first),
        MappingProxyType(indices),
        MappingProxyType(sumo_lanes),
    )
