"""How a car moves: highway-env's steering and bicycle model."""

from __future__ import annotations

import math
from typing import Any

from sumo_env.replica.compiled import borrowing
from sumo_env.replica.geometry import heading_at, not_zero, wrapped
from sumo_env.replica.numpy_loops import unary
from sumo_env.scene import VEHICLE_LENGTH

KP_ACCELERATION = 1 / 0.6  # [1/s]
KP_HEADING = 1 / 0.2  # [1/s]
KP_LATERAL = 1 / 0.6  # [1/s]
TAU_PURSUIT = 0.5 * 0.2  # [s] look-ahead
MAX_STEERING_ANGLE = math.pi / 3  # [rad]
MAX_SPEED = 40.0  # [m/s] beyond which a car is slowed down softly, in reverse as well


@borrowing
def clip(value: float, low: float, high: float) -> float:
    """``np.clip``."""
    return min(max(value, low), high)


@borrowing
def steer(lanes: Any, places: Any, loops: Any, car: Any, i: int) -> None:
    """``ControlledVehicle.steering_control``: write the angle that leads a car to the middle of its target lane."""
    s, lat = places.s[car.target, i], places.lat[car.target, i]
    speed = not_zero(car.speed)
    ahead = heading_at(lanes[car.target], s + car.speed * TAU_PURSUIT, loops)
    if car.is_linear:  # ``LinearVehicle.steering_control``
        turn = wrapped(ahead - car.heading) * VEHICLE_LENGTH / speed
        angle = car.heading_gain * turn + car.lateral_gain * (-lat * VEHICLE_LENGTH / (speed * speed))
        car.steering = clip(angle, -MAX_STEERING_ANGLE, MAX_STEERING_ANGLE)
        return
    sideways = unary(loops.arcsin, clip(-KP_LATERAL * lat / speed, -1.0, 1.0))
    wanted = ahead + clip(sideways, -math.pi / 4, math.pi / 4)
    rate = KP_HEADING * wrapped(wanted - car.heading)
    slip = unary(loops.arcsin, clip(VEHICLE_LENGTH / 2 / speed * rate, -1.0, 1.0))
    car.steering = clip(
        unary(loops.arctan, 2 * unary(loops.tan, slip)), -MAX_STEERING_ANGLE, MAX_STEERING_ANGLE
    )


@borrowing
def move(car: Any, loops: Any, dt: float) -> None:
    """``Vehicle.step``: an explicit Euler step of `dt` [s]; wrecks coast straight on."""
    if car.crashed:
        car.steering, car.acceleration = 0.0, -car.speed
    if car.speed > MAX_SPEED:
        car.acceleration = min(car.acceleration, MAX_SPEED - car.speed)
    elif car.speed < -MAX_SPEED:
        car.acceleration = max(car.acceleration, -MAX_SPEED - car.speed)
    if car.steering == 0.0:
        slip, c, s = 0.0, car.cos, car.sin
    else:
        slip = unary(loops.arctan, 1 / 2 * unary(loops.tan, car.steering))
        c, s = math.cos(car.heading + slip), math.sin(car.heading + slip)
    car.x += car.speed * c * dt
    car.y += car.speed * s * dt
    if car.is_pushed_apart:
        car.x += car.apart_x
        car.y += car.apart_y
        car.crashed, car.is_pushed_apart = True, False
    if slip != 0.0:
        car.heading += car.speed * math.sin(slip) / (VEHICLE_LENGTH / 2) * dt
        car.cos, car.sin = math.cos(car.heading), math.sin(car.heading)
    car.speed += car.acceleration * dt
    car.timer += dt
