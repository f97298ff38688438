"""How a car moves: highway-env's steering and bicycle model."""

from __future__ import annotations

import math
from typing import Any

from sumo_env.replica.compiled import borrowing
from sumo_env.replica.geometry import heading_at, not_zero, wrapped
from sumo_env.replica.numpy_loops import arcsin, arctan, each, tan
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
def steer_linearly(car: Any, ahead: float, lat: float) -> float:
    """``LinearVehicle.steering_control``: the angle [rad] of a car at `lat` [m]; ahead: heading of its lane [rad]."""
    speed = not_zero(car.speed)
    turn = wrapped(ahead - car.heading) * VEHICLE_LENGTH / speed
    return car.heading_gain * turn + car.lateral_gain * (-lat * VEHICLE_LENGTH / (speed * speed))


@borrowing
def steer(lanes: Any, cars: Any, places: Any) -> None:
    """``ControlledVehicle.steering_control``: write the angles that lead cars to the middle of their target lanes."""
    angles = places.room[0]
    for i in range(len(cars)):
        lat = places.lat[cars[i].target, i]
        angles[i] = clip(-KP_LATERAL * lat / not_zero(cars[i].speed), -1.0, 1.0)
    each(arcsin, angles)
    for i in range(len(cars)):
        car = cars[i]
        s, lat = places.s[car.target, i], places.lat[car.target, i]
        ahead = heading_at(lanes[car.target], s + car.speed * TAU_PURSUIT)
        rate = KP_HEADING * wrapped(ahead + clip(angles[i], -math.pi / 4, math.pi / 4) - car.heading)
        angles[i] = clip(VEHICLE_LENGTH / 2 / not_zero(car.speed) * rate, -1.0, 1.0)
        if car.is_linear:
            car.steering = steer_linearly(car, ahead, lat)
    each(arcsin, angles)
    each(tan, angles)
    angles *= 2
    each(arctan, angles)
    for i in range(len(cars)):
        angle = cars[i].steering if cars[i].is_linear else angles[i]
        cars[i].steering = clip(angle, -MAX_STEERING_ANGLE, MAX_STEERING_ANGLE)


@borrowing
def move(cars: Any, places: Any, dt: float) -> None:
    """``Vehicle.step``: an explicit Euler step of `dt` [s]; wrecks coast straight on."""
    slips = places.room[0]
    for i in range(len(cars)):
        if cars[i].crashed:
            cars[i].steering, cars[i].acceleration = 0.0, -cars[i].speed
        slips[i] = cars[i].steering
    each(tan, slips)
    slips *= 1 / 2
    each(arctan, slips)
    for i in range(len(cars)):
        car, slip = cars[i], slips[i]
        if car.speed > MAX_SPEED:
            car.acceleration = min(car.acceleration, MAX_SPEED - car.speed)
        elif car.speed < -MAX_SPEED:
            car.acceleration = max(car.acceleration, -MAX_SPEED - car.speed)
        c, s = car.cos, car.sin
        if slip != 0.0:
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
