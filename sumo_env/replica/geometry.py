"""Points on lanes (``highway_env.road.lane``), and where all cars are on all lanes.

A lane's own coordinates (s, lat) are metres along its centre line and to the right of it.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from sumo_env.replica.compiled import compiled, inlined
from sumo_env.replica.numpy_loops import arctan, arctan2, each_pair, unary
from sumo_env.replica.tables import CIRCULAR, NONE, SINE
from sumo_env.scene import VEHICLE_LENGTH

TURN = 2.0 * math.pi  # [rad]
NEAR = 3.0  # [m] half a lane's width and the margin of 1 m, within which a car counts as on a lane


class Places(NamedTuple):
    """Where all cars are on all lanes, for as long as they do not move; most have shape (lanes, cars)."""

    s: Any  # coordinates of the cars [m]
    lat: Any
    order: Any  # the cars that a driver on a lane sees, from the rear to the front
    seen: Any  # where each of these is along the lane [m]
    count: Any  # how many these are, shape (lanes,); NONE until `neighbours.sort_lane` has sorted them
    free: Any  # acceleration of each driver on a free road [m/s2], shape (cars,), see `driving.free_roads`
    room: Any  # for numbers of each car that a kernel needs meanwhile, shape (4, cars)


@inlined
def wrapped(angle: float) -> float:
    """``utils.wrap_to_pi`` [rad], to the bit; within a turn or two, where nearly all angles are, without a division."""
    shifted = angle + math.pi
    if -TURN < shifted < 0.0:
        shifted += TURN
    elif TURN <= shifted < 2.0 * TURN:
        shifted -= TURN
    elif not 0.0 <= shifted < TURN:
        shifted %= TURN
    return shifted - math.pi


@inlined
def not_zero(value: float) -> float:
    """``utils.not_zero``."""
    if abs(value) > 1e-2:
        return value
    return 1e-2 if value >= 0.0 else -1e-2


@inlined
def position(lane: Any, s: float) -> tuple[float, float]:
    """``AbstractLane.position`` on the centre line, x and y [m]."""
    if lane.kind == CIRCULAR:
        phi = lane.turn * s / lane.radius + lane.start_phase
        return lane.x + lane.radius * math.cos(phi), lane.y + lane.radius * math.sin(phi)
    lat = lane.amplitude * math.sin(lane.pulsation * s + lane.phase) if lane.kind == SINE else 0.0
    return lane.x + s * lane.cos - lat * lane.sin, lane.y + s * lane.sin + lat * lane.cos


@inlined
def heading_at(lane: Any, s: float) -> float:
    """``AbstractLane.heading_at`` [rad]."""
    if lane.kind == CIRCULAR:
        return lane.turn * s / lane.radius + lane.start_phase + math.pi / 2.0 * lane.turn
    if lane.kind == SINE:
        slope = lane.amplitude * lane.pulsation * math.cos(lane.pulsation * s + lane.phase)
        return lane.heading + unary(arctan, slope)
    return lane.heading


@inlined
def on_axis(lane: Any, x: float, y: float) -> tuple[float, float]:
    """(s, lat) [m] on a straight or sine lane."""
    dx, dy = x - lane.x, y - lane.y
    s, lat = dx * lane.cos + dy * lane.sin, dy * lane.cos - dx * lane.sin
    if lane.kind == SINE:
        lat -= lane.amplitude * math.sin(lane.pulsation * s + lane.phase)
    return s, lat


@inlined
def on_circle(lane: Any, phi: float, radius: float) -> tuple[float, float]:
    """(s, lat) [m] on a circular lane of the point with these polar coordinates about its centre [rad, m]."""
    phi = lane.start_phase + wrapped(phi - lane.start_phase)
    return lane.turn * (phi - lane.start_phase) * lane.radius, lane.turn * (lane.radius - radius)


@inlined
def local_coordinates(lane: Any, x: float, y: float) -> tuple[float, float]:
    """``AbstractLane.local_coordinates``: (s, lat) [m]."""
    if lane.kind == CIRCULAR:
        dx, dy = x - lane.x, y - lane.y
        return on_circle(lane, math.atan2(dy, dx), math.sqrt(dx * dx + dy * dy))
    return on_axis(lane, x, y)


@inlined
def beyond_ends(lane: Any, s: float, lat: float) -> float:
    """``AbstractLane.distance`` of the point (s, lat) [m]."""
    return abs(lat) + max(s - lane.length, 0.0) + max(-s, 0.0)


@inlined
def is_on(lane: Any, s: float, lat: float) -> bool:
    """``AbstractLane.on_lane`` with a margin of 1 m."""
    return abs(lat) <= NEAR and -VEHICLE_LENGTH <= s < lane.length + VEHICLE_LENGTH


@compiled
def no_places(lanes: Any, cars: Any) -> Places:
    """Room for the places of these cars, to be filled by `locate`."""
    n, shape = len(cars), (len(lanes), len(cars))
    s, lat, order, seen = np.empty(shape), np.empty(shape), np.empty(shape, np.int64), np.empty(shape)
    return Places(s, lat, order, seen, np.empty(len(lanes), np.int64), np.empty(n), np.empty((4, n)))


@inlined
def locate(lanes: Any, cars: Any, places: Any) -> None:
    """Write where all cars are on all lanes into `places`; nobody has looked at anybody yet."""
    places.count[:] = NONE
    x, y, phi, radius = places.room[0], places.room[1], places.room[2], places.room[3]
    for j in range(len(cars)):
        x[j], y[j] = cars[j].x, cars[j].y
    centre_x, centre_y = math.nan, math.nan
    for k in range(len(lanes)):
        lane = lanes[k]
        # most bends share one centre
        if lane.kind == CIRCULAR and (lane.x != centre_x or lane.y != centre_y):
            centre_x, centre_y = lane.x, lane.y
            for j in range(len(cars)):
                phi[j], radius[j] = y[j] - centre_y, x[j] - centre_x
            each_pair(arctan2, phi, radius)
            for j in range(len(cars)):
                radius[j] = math.sqrt((x[j] - centre_x) ** 2 + (y[j] - centre_y) ** 2)
        for j in range(len(cars)):
            if lane.kind == CIRCULAR:
                places.s[k, j], places.lat[k, j] = on_circle(lane, phi[j], radius[j])
            else:
                places.s[k, j], places.lat[k, j] = on_axis(lane, x[j], y[j])


@inlined
def from_lane(lane: Any, s: float, lat: float, heading: float) -> float:
    """``AbstractLane.distance_with_heading`` of a car at (s, lat) [m]."""
    return beyond_ends(lane, s, lat) + abs(wrapped(heading - heading_at(lane, s)))


@inlined
def closest_lane(lanes: Any, places: Any, j: int, heading: float, last: int) -> int:
    """``RoadNetwork.get_closest_lane_index`` of car `j`, which was on lane `last`; of equally close lanes the first."""
    enough = from_lane(lanes[last], places.s[last, j], places.lat[last, j], heading)
    best, least = 0, math.inf
    for k in range(len(lanes)):
        s, lat = places.s[k, j], places.lat[k, j]
        if abs(lat) <= enough and beyond_ends(lanes[k], s, lat) <= enough:
            distance = from_lane(lanes[k], s, lat, heading)
            if distance < least:
                best, least = k, distance
    return best
