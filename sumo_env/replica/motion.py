"""How a car moves: highway-env's steering and bicycle model."""

import math
from typing import Any

from sumo_env.replica.compiled import inlined
from sumo_env.replica.geometry import heading_at, not_zero, wrapped
from sumo_env.replica.numpy_loops import arcsin, arctan, arctan2, binary, each, tan
from sumo_env.scene import MAX_SPEED, VEHICLE_LENGTH, VEHICLE_WIDTH

KP_ACCELERATION = 1 / 0.6  # [1/s]
KP_HEADING = 1 / 0.2  # [1/s]
KP_LATERAL = 1 / 0.6  # [1/s]
TAU_PURSUIT = 0.5 * 0.2  # [s] look-ahead
MAX_STEERING_ANGLE = math.pi / 3  # [rad]
# ``BicycleVehicle``, for a mass of 1 kg:
FRICTION = 15.0  # [N/rad] of an axle's tyres
YAW_INERTIA = 1 / 12 * (VEHICLE_LENGTH**2 + VEHICLE_WIDTH**2)  # [kg m2]
MAX_YAW_RATE = 2 * math.pi  # [rad/s]


@inlined
def clip(value: float, low: float, high: float) -> float:
    """``np.clip``."""
    return min(max(value, low), high)


@inlined
def steer_linearly(car: Any, ahead: float, lat: float) -> float:
    """``LinearVehicle.steering_control``: the angle [rad] of a car at `lat` [m]; ahead: heading of its lane [rad]."""
    speed = not_zero(car.speed)
    turn = wrapped(ahead - car.heading) * VEHICLE_LENGTH / speed
    return car.heading_gain * turn + car.lateral_gain * (-lat * VEHICLE_LENGTH / (speed * speed))


@inlined
def steer(lanes: Any, cars: Any, places: Any, rules: Any) -> None:
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
        if rules.is_steered and cars[i].is_ego:
            continue
        angle = cars[i].steering if cars[i].is_linear else angles[i]
        cars[i].steering = clip(angle, -MAX_STEERING_ANGLE, MAX_STEERING_ANGLE)


@inlined
def slopes(car: Any, heading: float, speed: float, lateral: float, yaw: float) -> tuple[Any, ...]:
    """``BicycleVehicle.derivative_func`` of x, y, heading, speed, lateral speed and yaw rate (Rajamani 2011)."""
    to_axle = VEHICLE_LENGTH / 2
    if abs(speed) < 1.0:
        front = -lateral - YAW_INERTIA / to_axle * yaw
        rear = -lateral + YAW_INERTIA / to_axle * yaw
    else:
        front = 2 * FRICTION * (car.steering - binary(arctan2, lateral + to_axle * yaw, speed))
        rear = 2 * FRICTION * (0 - binary(arctan2, lateral - to_axle * yaw, speed))
    c, s = math.cos(heading), math.sin(heading)
    return (
        c * speed - s * lateral,
        s * speed + c * lateral,
        yaw,
        car.acceleration,
        front + rear - yaw * speed,
        1 / YAW_INERTIA * (to_axle * front - to_axle * rear),
    )


@inlined
def slide(car: Any, dt: float) -> None:
    """``BicycleVehicle.step``: a Runge-Kutta step of `dt` [s] with tyres that slip; contacts do not push such a car."""
    car.steering = clip(car.steering, -math.pi / 2, math.pi / 2)
    car.yaw_rate = clip(car.yaw_rate, -MAX_YAW_RATE, MAX_YAW_RATE)
    x, y, heading, speed = car.x, car.y, car.heading, car.speed
    lateral, yaw = car.lateral_speed, car.yaw_rate
    half = dt / 2
    a = slopes(car, heading, speed, lateral, yaw)
    b = slopes(car, heading + a[2] * half, speed + a[3] * half, lateral + a[4] * half, yaw + a[5] * half)
    c = slopes(car, heading + b[2] * half, speed + b[3] * half, lateral + b[4] * half, yaw + b[5] * half)
    d = slopes(car, heading + c[2] * dt, speed + c[3] * dt, lateral + c[4] * dt, yaw + c[5] * dt)
    car.x = x + dt / 6 * (a[0] + 2 * b[0] + 2 * c[0] + d[0])
    car.y = y + dt / 6 * (a[1] + 2 * b[1] + 2 * c[1] + d[1])
    car.heading = heading + dt / 6 * (a[2] + 2 * b[2] + 2 * c[2] + d[2])
    car.speed = speed + dt / 6 * (a[3] + 2 * b[3] + 2 * c[3] + d[3])
    car.lateral_speed = lateral + dt / 6 * (a[4] + 2 * b[4] + 2 * c[4] + d[4])
    car.yaw_rate = yaw + dt / 6 * (a[5] + 2 * b[5] + 2 * c[5] + d[5])
    car.cos, car.sin = math.cos(car.heading), math.sin(car.heading)


@inlined
def move(cars: Any, slips: Any, rules: Any, dt: float) -> None:
    """``Vehicle.step``: an explicit Euler step of `dt` [s]; wrecks coast straight on.

    Beyond MAX_SPEED a car is slowed down softly, in reverse as well. slips: room for a number of each car.
    """
    for i in range(len(cars)):
        if cars[i].crashed:
            cars[i].steering, cars[i].acceleration = 0.0, -cars[i].speed
        slips[i] = cars[i].steering
    each(tan, slips)
    slips *= 1 / 2
    each(arctan, slips)
    for i in range(len(cars)):
        car, slip = cars[i], slips[i]
        slowest, fastest = (rules.slowest, rules.fastest) if car.is_ego else (-MAX_SPEED, MAX_SPEED)
        if car.speed > fastest:
            car.acceleration = min(car.acceleration, fastest - car.speed)
        elif car.speed < slowest:
            car.acceleration = max(car.acceleration, slowest - car.speed)
        if rules.is_dynamical and car.is_ego:
            slide(car, dt)
            continue
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
