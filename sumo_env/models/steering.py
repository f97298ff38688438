"""How a car moves sideways: highway-env's steering (``ControlledVehicle.steering_control``, ``Vehicle.step``).

A lateral controller asks for a heading, a heading controller for a steering angle, and a bicycle model turns it into
motion: a lane change is exponential (half of it after 0.47 s), and in bends cars drive inside of the middle of their
lane, with the nose pointing outward.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from networks.lanes import VEHICLE_LENGTH
from sumo_env.compiled import compiled
from sumo_env.models.lane_table import Floats, Integers, heading_at, local_coordinates

TAU_HEADING = 0.2  # [s]
TAU_LATERAL = 0.6  # [s]
TAU_PURSUIT = 0.1  # [s] look-ahead
MAX_STEERING_ANGLE = math.pi / 3  # [rad]
REFERENCE_STEP = 1.0 / 15.0  # [s] of highway-env
SMALL = 0.01


@compiled
def _not_zero(value: float) -> float:
    if abs(value) > SMALL:
        return value
    return SMALL if value >= 0.0 else -SMALL


@compiled
def slip_angle(geometry: Floats, lane: int, x: float, y: float, heading: float, speed: float) -> float:
    """Angle [rad] from the heading to the direction of motion, of a car that steers for a lane's middle."""
    s, lat = local_coordinates(geometry, lane, x, y)
    ahead = heading_at(geometry, lane, s + speed * TAU_PURSUIT)
    sideways = min(max(-lat / TAU_LATERAL / _not_zero(speed), -1.0), 1.0)
    wanted = ahead + min(max(math.asin(sideways), -math.pi / 4), math.pi / 4)
    turn = (wanted - heading + math.pi) % (2.0 * math.pi) - math.pi
    slip = math.asin(min(max(VEHICLE_LENGTH / 2 / _not_zero(speed) * turn / TAU_HEADING, -1.0), 1.0))
    steering = min(max(math.atan(2.0 * math.tan(slip)), -MAX_STEERING_ANGLE), MAX_STEERING_ANGLE)
    return math.atan(0.5 * math.tan(steering))


@compiled
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


@compiled
def offsets(
    geometry: Floats, lane: Integers, x: Floats, y: Floats, to_x: Floats, to_y: Floats
) -> tuple[Floats, Floats]:
    """Ways from (x, y) to (to_x, to_y) [m] along and to the right of a lane, as it runs in between; shape (n,) each."""
    along, right = np.empty(len(x)), np.empty(len(x))
    for i in range(len(x)):
        middle_x, middle_y = (x[i] + to_x[i]) / 2.0, (y[i] + to_y[i]) / 2.0
        heading = heading_at(geometry, lane[i], local_coordinates(geometry, lane[i], middle_x, middle_y)[0])
        cos, sin = math.cos(heading), math.sin(heading)
        dx, dy = to_x[i] - x[i], to_y[i] - y[i]
        along[i], right[i] = dx * cos + dy * sin, dy * cos - dx * sin
    return along, right
