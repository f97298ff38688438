"""How a car moves sideways: highway-env's steering (``ControlledVehicle.steering_control``, ``Vehicle.step``).

A lateral controller asks for a heading, a heading controller for a steering angle, and a bicycle model turns it into
motion: a lane change is exponential (half of it after 0.47 s), and in bends cars drive inside of the middle of their
lane, with the nose pointing outward.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sumo_env.angles import wrapped
from sumo_env.cars import (
    ACCELERATION,
    BEFORE,
    CHANGE,
    COMMAND,
    CRASHED,
    DISTANCE,
    FRONT_X,
    FRONT_Y,
    HEADING,
    LANE,
    LATERAL,
    MOVED,
    SPEED,
    TARGET,
    Flags,
    X,
    Y,
)
from sumo_env.compiled import borrowing
from sumo_env.ego import REFERENCE_STEP, coast
from sumo_env.models.lane_table import (
    CIRCULAR,
    KIND,
    LENGTH,
    RADIUS,
    Floats,
    Integers,
    direction_at,
    heading_at,
    local_coordinates,
)
from sumo_env.models.motion import euler
from sumo_env.networks.lanes import VEHICLE_LENGTH, WIDTH

TAU_HEADING = 0.2  # [s]
TAU_LATERAL = 0.6  # [s]
TAU_PURSUIT = 0.1  # [s] look-ahead
MAX_STEERING_ANGLE = math.pi / 3  # [rad]
SMALL = 0.01
HALF = VEHICLE_LENGTH / 2  # [m] from the centre to the front bumper
STILL = 1e-4  # [m] sideways that SUMO need not be told
NEARLY = 1e-3  # [m]
OFF = 0.05  # [m] that SUMO's car may be ahead: its speed is not negative, so that it has to be put back
STAYS, BACK = -1, -2  # instead of the place of a lane


@borrowing
def _not_zero(value: float) -> float:
    if abs(value) > SMALL:
        return value
    return SMALL if value >= 0.0 else -SMALL


@borrowing
def slip_angle(geometry: Floats, lane: int, x: float, y: float, heading: float, speed: float) -> float:
    """Angle [rad] from the heading to the direction of motion, of a car that steers for a lane's middle."""
    s, lat = local_coordinates(geometry, lane, x, y)
    ahead = heading_at(geometry, lane, s + speed * TAU_PURSUIT)
    sideways = min(max(-lat / TAU_LATERAL / _not_zero(speed), -1.0), 1.0)
    if sideways == 0.0 and ahead == heading:
        return 0.0
    wanted = ahead + min(max(math.asin(sideways), -math.pi / 4), math.pi / 4)
    turn = wrapped(wanted - heading)
    slip = math.asin(min(max(VEHICLE_LENGTH / 2 / _not_zero(speed) * turn / TAU_HEADING, -1.0), 1.0))
    steering = min(max(math.atan(2.0 * math.tan(slip)), -MAX_STEERING_ANGLE), MAX_STEERING_ANGLE)
    return math.atan(0.5 * math.tan(steering))


@borrowing
def steer(
    geometry: Floats,
    target: Integers,
    x: Floats,
    y: Floats,
    heading: Floats,
    distance: Floats,
    crashed: NDArray[np.bool_],
    dt: float,
) -> None:
    """Move every car by `distance` [m] within `dt` [s], steering for its target lane; wrecks drive straight on.

    Changes x, y [m] and heading [rad] in place. In Euler steps no longer than highway-env's, because its controller
    is stiff and its lag is that of these steps. Shapes (n,); `target`: numbers of lanes.
    """
    for i in range(len(x)):
        left, speed = dt, distance[i] / dt
        while left > 1e-9:
            step = min(left, REFERENCE_STEP)
            left -= step
            slip = 0.0 if crashed[i] else slip_angle(geometry, target[i], x[i], y[i], heading[i], speed)
            x[i] += speed * math.cos(heading[i] + slip) * step
            y[i] += speed * math.sin(heading[i] + slip) * step
            heading[i] += speed * math.sin(slip) / (VEHICLE_LENGTH / 2) * step


@borrowing
def _on_line(points: Floats, x: float, y: float) -> tuple[float, float]:
    """How far along a line of points [m], shape (n, 2), (x, y) is, and how far to the right of it."""
    s, right, nearest, begin = 0.0, 0.0, math.inf, 0.0
    for i in range(len(points) - 1):
        dx, dy = points[i + 1, 0] - points[i, 0], points[i + 1, 1] - points[i, 1]
        length = math.sqrt(dx * dx + dy * dy)
        cos, sin = dx / length, dy / length
        rx, ry = x - points[i, 0], y - points[i, 1]
        along = min(max(rx * cos + ry * sin, 0.0), length)
        apart = (rx - along * cos) ** 2 + (ry - along * sin) ** 2
        if apart < nearest:
            s, right, nearest = begin + along, ry * cos - rx * sin, apart
        begin += length
    return s, right


@borrowing
def follow(
    geometry: Floats,
    lane: Integers,
    number: Integers,
    place: Integers,
    count: Integers,
    joint: Integers,
    joints: Floats,
    stretch: Floats,
    front: Floats,
    x: Floats,
    y: Floats,
    heading: Floats,
    dt: float,
    lateral: Floats,
    speed: Floats,
    change: Integers,
) -> None:
    """What brings SUMO's cars to the poses (x, y, heading), shape (n,) each, within `dt` [s].

    Args:
        lane: SUMO's lane of each car, shape (n,).
        number, place, count, joint, stretch: by SUMO's lanes: row in `geometry`, place from the left, lanes beside each
            other (0 where none can be changed to), row in `joints` or -1, factor for speeds.
        joints: points of joints, which turn where no lane of highway-env's does [m], shape (joints, points, 2).
        front: front bumpers of SUMO's cars [m], shape (2, n).
        lateral: to the left of the middle of the lane [m], shape (n,): as it is, and then as it is to be.
        speed: is given the speed to command [m/s], shape (n,).
        change: is given the place of the lane that the car is on from now on, STAYS, or BACK if it has to be put where
            it is to be, shape (n,).
    """
    for i in range(len(x)):
        on, here = number[lane[i]], place[lane[i]]
        # front bumpers are what SUMO moves along its lanes
        to_x, to_y = x[i] + HALF * math.cos(heading[i]), y[i] + HALF * math.sin(heading[i])
        if joint[lane[i]] >= 0:
            line = joints[joint[lane[i]]]
            ahead, right = _on_line(line, to_x, to_y)
            ahead -= _on_line(line, front[0, i], front[1, i])[0]
            lateral[i] = -right
        elif geometry[on, KIND] == CIRCULAR:
            ahead, right = local_coordinates(geometry, on, to_x, to_y)
            ahead -= local_coordinates(geometry, on, front[0, i], front[1, i])[0]
            ahead = wrapped(ahead, math.pi * geometry[on, RADIUS])
            lateral[i] = -right
        else:  # as the lane runs in between
            dx, dy = to_x - front[0, i], to_y - front[1, i]
            cos, sin = direction_at(geometry, on, front[0, i] + dx / 2.0, front[1, i] + dy / 2.0)
            ahead = dx * cos + dy * sin
            lateral[i] -= dy * cos - dx * sin
        speed[i] = max(ahead, 0.0) / dt * stretch[lane[i]]
        change[i] = STAYS
        if ahead < -OFF:
            change[i] = BACK
        elif lateral[i] > WIDTH / 2 and 0 < here < count[lane[i]]:
            lateral[i] -= WIDTH
            change[i] = here - 1
        elif lateral[i] < -WIDTH / 2 and here + 1 < count[lane[i]]:
            lateral[i] += WIDTH
            change[i] = here + 1


@borrowing
def is_near_end(geometry: Floats, lane: int, x: float, y: float) -> bool:
    """Is a car at (x, y) [m] about to be due for its next lane (`sumo_env.networks.lanes.Lane.after_end`)?"""
    return geometry[lane, LENGTH] - local_coordinates(geometry, lane, x, y)[0] < VEHICLE_LENGTH / 2 + NEARLY


@borrowing
def move(
    geometry: Floats,
    lanes: Integers,
    joints: Floats,
    stretch: Floats,
    floats: Floats,
    integers: Integers,
    flags: Flags,
    dt: float,
) -> tuple[bool, bool]:
    """Move all cars by their accelerations (the ego by its distance), and find what SUMO is to be told.

    Args:
        geometry: of a `LaneTable`.
        lanes: number, place, count and joint of `follow`, by SUMO's lanes, shape (4, lanes).
        joints, stretch: as there.
        floats, integers, flags: of `cars.Cars`.
        dt: [s].

    Returns:
        whether somebody changes lane in SUMO or is put back, and whether the ego is about to reach the end of the lane
        it steers for.
    """
    speed, distance, crashed, target = floats[SPEED], floats[DISTANCE], flags[CRASHED], integers[TARGET]
    x, y, heading, lateral = floats[X], floats[Y], floats[HEADING], floats[LATERAL]
    for i in range(len(x)):
        floats[BEFORE, i], floats[BEFORE + 1, i], floats[BEFORE + 2, i] = x[i], y[i], heading[i]
    # highway-env's cars roll back to their distance; SUMO's own cannot
    euler(speed, floats[ACCELERATION], crashed, dt, -math.inf, speed, distance)
    for i in range(1, len(x)):
        if crashed[i]:
            speed[i], distance[i] = coast(speed[i], dt)
    steer(geometry, target, x, y, heading, distance, crashed, dt)
    moved, change = flags[MOVED], integers[CHANGE]
    for i in range(len(x)):
        moved[i] = abs(lateral[i]) > STILL
    follow(
        geometry, integers[LANE], lanes[0], lanes[1], lanes[2], lanes[3], joints, stretch,
        floats[FRONT_X : FRONT_Y + 1], x, y, heading, dt, lateral, floats[COMMAND], change,
    )  # fmt: skip
    changes = False
    for i in range(len(x)):
        moved[i] = moved[i] or abs(lateral[i]) > STILL
        changes = changes or change[i] != STAYS
    return changes, is_near_end(geometry, target[0], x[0], y[0])
