"""What is painted of a road: its surface, edges, lines, stop lines and traffic lights, as polygons in metres.

Derived from the lanes alone. Edge lines need no rule for junctions: every strip of surface is first drawn in white
and slightly wider, then all surfaces are drawn over that, so white remains only at the rim of their union.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import dropwhile

import numpy as np
from numpy.typing import NDArray

from sumo_env.networks.lanes import Lane, PolyLane, StraightLane, wrap_to_pi
from sumo_env.networks.plans import bow
from sumo_env.networks.roads import LaneIndex, Road

Points = NDArray[np.float64]  # shape (k, 2) [m]

LINE_WIDTH = 0.3  # [m] LaneGraphics.STRIPE_WIDTH
DASH_LENGTH = 3.0  # [m] LaneGraphics.STRIPE_LENGTH
DASH_SPACING = 4.33  # [m] LaneGraphics.STRIPE_SPACING
RUN_OUT = 300.0  # [m] that roads are drawn beyond their ends, where vehicles come from and go to
STEP = 1.0  # [m] between the points of a curve
NEAR = 0.5  # [m] lanes whose ends are closer than this are joined, and those of two directions without a gap
STOP_LINE = 0.8  # [m] from front to back


@dataclass(frozen=True)
class Markings:
    """Polygons to fill, arrays (k, 2) [m]: `rims` white, then `surfaces` grey, then the rest white."""

    rims: tuple[Points, ...]
    surfaces: tuple[Points, ...]
    dashes: tuple[Points, ...]
    lines: tuple[Points, ...]  # between directions on SUMO's own networks, and where one stops or gives way
    # parts of stop lines; of the way on from there, id of the traffic light and place among its letters
    lights: tuple[tuple[Points, str, int], ...]


def markings(road: Road) -> Markings:
    """The markings of a road."""
    strips = [
        (_strip(lane, *_extent(road, index, lane)), lane.width / 2) for index, lane in road.lanes.items()
    ]
    strips += [(_bend(*joint), joint[0].width / 2) for joint in _open_joints(road)]
    return Markings(
        rims=tuple(_outline(strip, half + LINE_WIDTH) for strip, half in strips),
        surfaces=tuple(_outline(strip, half) for strip, half in strips),
        dashes=tuple(dash for divider in _dividers(road) for dash in _dashes(*divider)),
        lines=(*_between_directions(road), *(_stop_line(road.lanes[index]) for index in road.stops)),
        lights=tuple(
            (_stop_line(road.lanes[index], number / len(ways), (number + 1) / len(ways)), *way)
            for index, ways in road.stops.items()
            for number, way in enumerate(ways)
        ),
    )


def _strip(lane: Lane, first: float, last: float) -> Points:
    """Centre line from s = first to last [m]; columns x, y, heading."""
    count = 2 if type(lane) is StraightLane else max(math.ceil((last - first) / STEP), 2)
    places = np.linspace(first, last, count).tolist()
    return np.array([(*lane.position(s, 0.0), lane.heading_at(s)) for s in places])


def _bend(before: Lane, after: Lane) -> Points:
    """A smooth centre line from the end of one lane to the start of another."""
    end = before.position(before.length, 0.0), before.heading_at(before.length)
    x, y = np.array(bow(*end, after.position(0.0, 0.0), after.heading_at(0.0))).T
    return np.column_stack([x, y, np.arctan2(np.gradient(y), np.gradient(x))])


def _outline(strip: Points, half_width: float) -> Points:
    """The polygon around a centre line."""
    x, y, heading = strip.T
    across = half_width * np.column_stack([-np.sin(heading), np.cos(heading)])
    centre = np.column_stack([x, y])
    return np.concatenate([centre + across, (centre - across)[::-1]])


def _continues(before: Lane, after: Lane) -> bool:
    """Whether `after` leads on in the direction in which `before` ends."""
    return abs(wrap_to_pi(after.heading_at(0.0) - before.heading_at(before.length))) < math.pi / 2


def _gap(before: Lane, after: Lane) -> float:
    """Distance [m] from the end of one lane to the start of another."""
    return math.dist(before.position(before.length, 0.0), after.position(0.0, 0.0))


def _extent(road: Road, index: LaneIndex, lane: Lane) -> tuple[float, float]:
    """From where to where a lane is drawn [m]; straight ones run on where no other lane joins them."""
    if type(lane) is not StraightLane:
        return 0.0, lane.length
    start, end, _ = index
    joined_before = any(b == start and _continues(other, lane) for (_, b, _), other in road.lanes.items())
    joined_after = any(a == end and _continues(lane, other) for (a, _, _), other in road.lanes.items())
    return (0.0 if joined_before else -RUN_OUT), lane.length + (0.0 if joined_after else RUN_OUT)


def _open_joints(road: Road) -> Iterator[tuple[Lane, Lane]]:
    """Successive lanes with a gap between them: the roundabout's entries and exits end off the ring."""
    for start, node in dict.fromkeys(index[:2] for index in road.lanes):
        for end in road.successors.get(node, ()):
            pairs = [
                (_gap(road.lanes[start, node, i], road.lanes[node, end, j]), i, j)
                for i in range(road.count(start, node))
                for j in range(road.count(node, end))
                if _continues(road.lanes[start, node, i], road.lanes[node, end, j])
            ]
            if pairs and min(pairs)[0] > NEAR:
                _, i, j = min(pairs)
                yield road.lanes[start, node, i], road.lanes[node, end, j]


def _dividers(road: Road) -> Iterator[tuple[Lane, float, float]]:
    """Lanes with a dashed line on their left side, and its extent [m]; SUMO's own have none within junctions."""
    for index, lane in road.lanes.items():
        is_inside = isinstance(lane, PolyLane) and not index[0].endswith(":from")
        if (index[2] > 0 and not is_inside) or _has_oncoming_neighbour(road, index, lane):
            yield lane, *_extent(road, index, lane)


def _has_oncoming_neighbour(road: Road, index: LaneIndex, lane: Lane) -> bool:
    """Whether a later lane runs beside this one, on its left, the other way (not inside a junction)."""
    if type(lane) is not StraightLane or len(road.successors[index[0]]) > 1 or road.count(*index[:2]) > 1:
        return False
    later = dropwhile(lambda item: item[0] != index, road.lanes.items())
    for other_index, other in later:
        if type(other) is not StraightLane or road.count(*other_index[:2]) > 1:
            continue
        s, lateral = lane.local_coordinates(*other.position(other.length / 2, 0.0))
        opposite = abs(wrap_to_pi(other.heading - lane.heading)) > math.pi - 0.01
        if opposite and abs(lateral + lane.width) < 0.1 and 0.0 < s < lane.length:
            return True
    return False


def _between_directions(road: Road) -> Iterator[Points]:
    """The lines between two directions of SUMO's edges, on the side where oncoming vehicles drive."""
    outer = [
        (lane, side * lane.width / 2)
        for (start, end, place), lane in road.lanes.items()
        for side, last in ((-1, 0), (1, road.count(start, end) - 1))
        if isinstance(lane, PolyLane) and start.endswith(":from") and place == last
    ]
    if not outer:
        return
    low, high = (np.array([limit(lane.points, axis=0) for lane, _ in outer]) for limit in (np.min, np.max))
    for lane, edge in outer:
        middle, heading = lane.position(lane.length / 2, edge), lane.heading_at(lane.length / 2)
        near = (low - lane.width < middle).all(axis=1) & (high + lane.width > middle).all(axis=1)
        for other, its_edge in (outer[k] for k in np.flatnonzero(near)):
            s, lateral = other.local_coordinates(*middle)
            turned = abs(wrap_to_pi(other.heading_at(s) - heading))
            if 0.0 < s < other.length and abs(lateral - its_edge) < NEAR and turned > math.pi / 2:
                yield _outline(_beside(_strip(lane, 0.0, lane.length), edge), LINE_WIDTH / 2)
                break


def _stop_line(lane: Lane, first: float = 0.0, last: float = 1.0) -> Points:
    """The stop line at the end of a lane, between two shares of its width, counted from the right."""
    right, left = lane.width * (0.5 - first), lane.width * (0.5 - last)
    front, back = lane.length, lane.length - STOP_LINE
    corners = (back, right), (back, left), (front, left), (front, right)
    return np.array([lane.position(*corner) for corner in corners])


def _beside(strip: Points, lateral: float) -> Points:
    """A line that is `lateral` [m] to the right of a centre line."""
    x, y, heading = strip.T
    return np.column_stack([x - lateral * np.sin(heading), y + lateral * np.cos(heading), heading])


def _dashes(lane: Lane, first: float, last: float) -> Iterator[Points]:
    """The dashes on the left side of a lane."""
    starts = np.arange(math.ceil(first / DASH_SPACING), last / DASH_SPACING) * DASH_SPACING
    half, edge = LINE_WIDTH / 2, -lane.width / 2
    if type(lane) is StraightLane:  # a highway has thousands
        along = np.array([math.cos(lane.heading), math.sin(lane.heading)])
        across = np.array([-along[1], along[0]])
        corners = np.array([(0.0, -half), (DASH_LENGTH, -half), (DASH_LENGTH, half), (0.0, half)])
        dash = np.array(lane.position(0.0, edge)) + corners[:, :1] * along + corners[:, 1:] * across
        yield from dash + starts[:, None, None] * along
        return
    for s in starts.tolist():
        yield _outline(_beside(_strip(lane, s, min(s + DASH_LENGTH, last)), edge), half)
