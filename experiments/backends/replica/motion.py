"""How a car moves: highway-env's steering and bicycle model (``ControlledVehicle.steering_control``, ``Vehicle.step``)."""

from __future__ import annotations

import math
from typing import Any

from experiments.backends.replica.compiled import compiled
from experiments.backends.replica.geometry import LAT, VEHICLE_LENGTH, S, heading_at, not_zero, wrapped

TAU_ACCELERATION = 0.6  # [s]
TAU_HEADING = 0.2  # [s]
TAU_LATERAL = 0.6  # [s]
TAU_PURSUIT = 0.1  # [s] look-ahead
MAX_STEERING_ANGLE = math.pi / 3  # [rad]
# tan(slip) = tan(steering) / 2, so that the limit of the steering angle is one of the slip angle:
MAX_SLIP = math.sin(math.atan(math.tan(MAX_STEERING_ANGLE) / 2.0))
MAX_SPEED = 40.0  # [m/s] beyond which a car is slowed down softly, in reverse as well


@compiled
def steer(lanes: Any, places: Any, car: Any, i: int) -> None:
    """Write the sine of the slip angle with which a car steers for its target lane.

    highway-env goes from the slip angle to a steering angle, which it clips, and back; this is the same without the
    detour.
    """
    s, lat = places[S, car.target, i], places[LAT, car.target, i]
    speed = not_zero(car.speed)
    ahead = heading_at(lanes[car.target], s + car.speed * TAU_PURSUIT)
    sideways = math.asin(min(max(-lat / TAU_LATERAL / speed, -1.0), 1.0))
    wanted = ahead + min(max(sideways, -math.pi / 4.0), math.pi / 4.0)
    rate = wrapped(wanted - car.heading) / TAU_HEADING
    car.slip = min(max(VEHICLE_LENGTH / 2.0 / speed * rate, -MAX_SLIP), MAX_SLIP)


@compiled
def move(car: Any, dt: float) -> None:
    """``Vehicle.step``: an explicit Euler step of `dt` [s]; wrecks coast straight on."""
    if car.crashed:
        car.slip, car.acceleration = 0.0, -car.speed
    if car.speed > MAX_SPEED:
        car.acceleration = min(car.acceleration, MAX_SPEED - car.speed)
    elif car.speed < -MAX_SPEED:
        car.acceleration = max(car.acceleration, -MAX_SPEED - car.speed)
    direction = car.heading + math.asin(car.slip)
    car.x += car.speed * math.cos(direction) * dt
    car.y += car.speed * math.sin(direction) * dt
    if car.is_pushed_apart:
        car.x += car.apart_x
        car.y += car.apart_y
        car.crashed, car.is_pushed_apart = True, False
    car.heading += car.speed * car.slip / (VEHICLE_LENGTH / 2.0) * dt
    car.speed += car.acceleration * dt
    car.timer += dt
