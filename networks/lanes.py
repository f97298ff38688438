"""Lane geometry: the three curves that highway-env's roads are made of, and the lanes of other SUMO networks.

Coordinates are highway-env's: x to the east, y *down*, metres; headings in radians from +x toward +y. A
point in a lane's own frame is (s, lat): s metres along the centre line from the lane's start, lat metres
to the right of it. Both may lie outside the lane: a straight lane extrapolates along its axis, a circular
one around its circle. Semantics equal `highway_env.road.lane` (1.12.1); `tests/networks/test_roads.py`
compares every lane of every task.

Arithmetic is on plain floats: a call takes about 0.2 microseconds, much less than with numpy scalars.
"""

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from itertools import accumulate, pairwise

WIDTH = 4.0  # [m], every lane of every task
VEHICLE_LENGTH = 5.0  # [m], the margin highway-env allows before and behind a lane
DEFAULT_SPEED_LIMIT = 20.0  # [m/s], highway-env's for lanes built without one

Point = tuple[float, float]


def wrap_to_pi(angle: float) -> float:
    """The same direction as `angle` [rad], in [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def quarter_turns(point: Point, quarters: int) -> Point:
    """`point` after `quarters` quarter turns about the origin, clockwise on the screen; exact."""
    x, y = point
    for _ in range(quarters % 4):
        x, y = -y, x
    return x, y


@dataclass(frozen=True, slots=True)
class Lane:
    """What all lanes share; the subclasses add the curve."""

    width: float = field(default=WIDTH, kw_only=True)  # [m]
    speed_limit: float = field(default=DEFAULT_SPEED_LIMIT, kw_only=True)  # [m/s]
    priority: int = field(default=0, kw_only=True)  # the larger one has right of way
    forbidden: bool = field(default=False, kw_only=True)  # nobody may change to it
    length: float = field(default=0.0, init=False)  # [m]

    def position(self, s: float, lat: float) -> Point:
        """World position (x, y) [m] of the point `s` [m] along and `lat` [m] right of the centre line."""
        raise NotImplementedError

    def heading_at(self, s: float) -> float:
        """Heading [rad] of the centre line at `s` [m]; not wrapped."""
        raise NotImplementedError

    def local_coordinates(self, x: float, y: float) -> Point:
        """The (s, lat) [m] of a world position; the inverse of `position`."""
        raise NotImplementedError

    def covers(self, s: float, lat: float, margin: float = 0.0) -> bool:
        """Is the point (s, lat) [m] on the lane, widened by `margin` [m] on both sides?

        As in highway-env the lane reaches one vehicle length beyond either end.
        """
        return abs(lat) <= self.width / 2 + margin and -VEHICLE_LENGTH <= s < self.length + VEHICLE_LENGTH

    def on_lane(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Is the world position on the lane, widened by `margin` [m] on both sides?"""
        return self.covers(*self.local_coordinates(x, y), margin)

    def is_reachable_from(self, x: float, y: float) -> bool:
        """Whether a vehicle at this position may steer for the lane: within two widths, not before its start."""
        s, lat = self.local_coordinates(x, y)
        return not self.forbidden and abs(lat) <= 2 * self.width and 0 <= s < self.length + VEHICLE_LENGTH

    def after_end(self, x: float, y: float) -> bool:
        """Whether a vehicle at this position is to take its next lane (half a vehicle before the end of this one)."""
        return self.local_coordinates(x, y)[0] > self.length - VEHICLE_LENGTH / 2

    def distance(self, x: float, y: float, heading: float | None = None) -> float:
        """L1 distance [m] of a world position to the lane, in the lane's frame.

        With a heading, 1 m is added for each radian between it and the lane's direction.
        """
        s, lat = self.local_coordinates(x, y)
        angle = 0.0 if heading is None else abs(wrap_to_pi(heading - self.heading_at(s)))
        return abs(lat) + max(s - self.length, 0.0) + max(-s, 0.0) + angle


@dataclass(frozen=True, slots=True)
class StraightLane(Lane):
    """A straight line from `start` to `end` [m]."""

    start: Point
    end: Point
    heading: float = field(init=False)
    _dx: float = field(init=False, repr=False)
    _dy: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        dx, dy = self.end[0] - self.start[0], self.end[1] - self.start[1]
        length = math.hypot(dx, dy)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "heading", math.atan2(dy, dx))
        object.__setattr__(self, "_dx", dx / length)
        object.__setattr__(self, "_dy", dy / length)

    def position(self, s: float, lat: float) -> Point:
        return (self.start[0] + s * self._dx - lat * self._dy, self.start[1] + s * self._dy + lat * self._dx)

    def heading_at(self, s: float) -> float:
        return self.heading

    def local_coordinates(self, x: float, y: float) -> Point:
        x -= self.start[0]
        y -= self.start[1]
        return x * self._dx + y * self._dy, y * self._dx - x * self._dy


@dataclass(frozen=True, slots=True)
class SineLane(StraightLane):
    """amplitude * sin(pulsation * s + phase) [m, rad/m, rad] to the right of the axis from `start` to `end`.

    `s` and `length` are measured along the axis, as in highway-env, not along the curve (2 % longer here).
    """

    amplitude: float
    pulsation: float
    phase: float

    def position(self, s: float, lat: float) -> Point:
        return StraightLane.position(self, s, lat + self._offset(s))

    def heading_at(self, s: float) -> float:
        slope = self.amplitude * self.pulsation * math.cos(self.pulsation * s + self.phase)
        return self.heading + math.atan(slope)

    def local_coordinates(self, x: float, y: float) -> Point:
        s, lat = StraightLane.local_coordinates(self, x, y)
        return s, lat - self._offset(s)

    def _offset(self, s: float) -> float:
        return self.amplitude * math.sin(self.pulsation * s + self.phase)


@dataclass(frozen=True, slots=True)
class CircularLane(Lane):
    """An arc about `center` [m] with `radius` [m] from `start_phase` to `end_phase` [rad, from +x toward +y].

    `clockwise` is as seen on the screen (y down), where growing phases turn clockwise: a right-hand bend.
    """

    center: Point
    radius: float
    start_phase: float
    end_phase: float
    clockwise: bool = True
    _turn: float = field(init=False, repr=False)  # +1 clockwise, -1 counter-clockwise

    def __post_init__(self) -> None:
        turn = 1.0 if self.clockwise else -1.0
        object.__setattr__(self, "_turn", turn)
        object.__setattr__(self, "length", self.radius * (self.end_phase - self.start_phase) * turn)

    def position(self, s: float, lat: float) -> Point:
        phi = self._turn * s / self.radius + self.start_phase
        r = self.radius - lat * self._turn
        return self.center[0] + r * math.cos(phi), self.center[1] + r * math.sin(phi)

    def heading_at(self, s: float) -> float:
        return self._turn * s / self.radius + self.start_phase + math.pi / 2 * self._turn

    def local_coordinates(self, x: float, y: float) -> Point:
        x -= self.center[0]
        y -= self.center[1]
        # The nearer way round: at most half a turn behind the start, then s jumps to half a turn ahead.
        turned = wrap_to_pi(math.atan2(y, x) - self.start_phase)
        return self._turn * turned * self.radius, self._turn * (self.radius - math.hypot(x, y))


@dataclass(frozen=True, slots=True)
class PolyLane(Lane):
    """Straight pieces from point to point [m], as SUMO draws its lanes; the first and the last one extrapolate."""

    points: tuple[Point, ...]
    _pieces: tuple[StraightLane, ...] = field(init=False, repr=False)
    _starts: tuple[float, ...] = field(init=False, repr=False)  # s where each piece begins [m]

    def __post_init__(self) -> None:
        pieces = tuple(StraightLane(a, b) for a, b in pairwise(self.points))
        starts = [0.0, *accumulate(piece.length for piece in pieces)]
        object.__setattr__(self, "length", starts.pop())
        object.__setattr__(self, "_pieces", pieces)
        object.__setattr__(self, "_starts", tuple(starts))

    def _piece(self, s: float) -> int:
        return max(bisect_right(self._starts, s) - 1, 0)

    def position(self, s: float, lat: float) -> Point:
        k = self._piece(s)
        return self._pieces[k].position(s - self._starts[k], lat)

    def heading_at(self, s: float) -> float:
        return self._pieces[self._piece(s)].heading

    def local_coordinates(self, x: float, y: float) -> Point:
        # on the nearest piece
        best, nearest, last = (0.0, 0.0), math.inf, len(self._pieces) - 1
        for k, piece in enumerate(self._pieces):
            s, lat = piece.local_coordinates(x, y)
            beyond = 0.0 if k == 0 else max(-s, 0.0)
            beyond += 0.0 if k == last else max(s - piece.length, 0.0)
            distance = math.hypot(beyond, lat)
            if distance < nearest:
                # at an outer corner between two pieces, s is that of the corner
                s = s if beyond == 0.0 else min(max(s, 0.0), piece.length)
                best, nearest = (self._starts[k] + s, math.copysign(distance, lat)), distance
        return best
