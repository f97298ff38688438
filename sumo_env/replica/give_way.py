"""Right of way at the intersection: ``RegulatedRoad.enforce_road_rules`` of highway-env.

Every pair of cars is looked at: each is predicted along its route at its present speed, and if the two would meet
within three seconds one of them has to give way, that is, its desired speed becomes 0 until the next time. It is the
one on the lane of lower priority or, on lanes of equal priority, the one that has the other further in front of it.
A learning car is never made to give way.
"""

import math
from typing import Any

import numpy as np

from sumo_env.replica.compiled import compiled, inlined
from sumo_env.replica.geometry import heading_at, position
from sumo_env.replica.motion import move
from sumo_env.replica.tables import NONE
from sumo_env.scene import VEHICLE_LENGTH, VEHICLE_WIDTH

SAMPLES, SAMPLE_STEP = 11, 0.25  # predictions of each car, at 0.25 s, 0.5 s .. 2.75 s
MEETING_DISTANCE = 5.0  # [m] centres that are further apart do not meet
# [m] of the rectangle that stands for a predicted car
HALF_LENGTH, HALF_WIDTH = 1.5 * VEHICLE_LENGTH / 2.0, 0.9 * VEHICLE_WIDTH / 2.0


@inlined
def route_lane(lanes: Any, car: Any, leg: int) -> int:
    """The lane of this leg of the route, NONE beyond its end: the planned one or that of the car's own number."""
    if leg >= len(car.route) or car.route[leg] == NONE:
        return NONE
    beside = car.planned if leg == car.leg and car.planned != NONE else car.lane - lanes[car.lane].road
    return car.route[leg] + beside


@inlined
def predict(lanes: Any, cars: Any, places: Any, predicted: Any) -> None:
    """Write x, y [m] and heading [rad] of all cars in the next seconds, shape (cars, SAMPLES, 3).

    ``ControlledVehicle.predict_trajectory_constant_speed``. A route begins with the road that a car *steers for*, while
    the way driven on it is that on the lane that it *is* on: in the last 2.5 m of a lane predictions are too far ahead.
    """
    for i in range(len(cars)):
        car = cars[i]
        for k in range(SAMPLES):
            s = places.s[car.lane, i] + car.speed * SAMPLE_STEP * (k + 1)
            leg, lane = car.leg, route_lane(lanes, car, car.leg)
            if lane == NONE:
                lane = car.lane
            else:
                following = route_lane(lanes, car, leg + 1)
                while following != NONE and s > lanes[lane].length:
                    s -= lanes[lane].length
                    leg, lane = leg + 1, following
                    following = route_lane(lanes, car, leg + 1)
            predicted[i, k, 0], predicted[i, k, 1] = position(lanes[lane], s)
            predicted[i, k, 2] = heading_at(lanes[lane], s)


@inlined
def predict_steered(cars: Any, rules: Any, ghost: Any, slip: Any, predicted: Any) -> None:
    """Write where steered learning cars will be if they keep their speeds and the angles of their wheels.

    ``Vehicle.predict_trajectory_constant_speed``; `ghost` is room for a copy of a car, `slip` for a number.
    """
    for i in range(len(cars)):
        if not cars[i].is_ego:
            continue
        ghost[0] = cars[i]
        ghost[0].acceleration = 0.0
        for k in range(SAMPLES):
            move(ghost, slip, rules, SAMPLE_STEP)
            predicted[i, k, 0], predicted[i, k, 1] = ghost[0].x, ghost[0].y
            predicted[i, k, 2] = ghost[0].heading


@inlined
def reaches_into(dx: float, dy: float, heading: float, other_heading: float) -> bool:
    """``utils.has_corner_inside``: is one of nine points of a rectangle in another one, (dx, dy) [m] away from it?

    highway-env turns points into the frame of the other rectangle the wrong way round, and so does this.
    """
    c, s = math.cos(other_heading), math.sin(other_heading)
    x, y = -c * dx + s * dy, -s * dx - c * dy
    c, s = math.cos(heading + other_heading), math.sin(heading + other_heading)
    for along in (-HALF_LENGTH, 0.0, HALF_LENGTH):
        for across in (-HALF_WIDTH, 0.0, HALF_WIDTH):
            if (
                abs(x + along * c - across * s) <= HALF_LENGTH
                and abs(y + along * s + across * c) <= HALF_WIDTH
            ):
                return True
    return False


@inlined
def will_meet(first: Any, second: Any) -> bool:
    """``RegulatedRoad.is_conflict_possible`` of two predicted cars, shapes (SAMPLES, 3)."""
    for k in range(SAMPLES):
        dx, dy = second[k, 0] - first[k, 0], second[k, 1] - first[k, 1]
        if dx * dx + dy * dy <= MEETING_DISTANCE * MEETING_DISTANCE and (
            reaches_into(dx, dy, first[k, 2], second[k, 2])
            or reaches_into(-dx, -dy, second[k, 2], first[k, 2])
        ):
            return True
    return False


@inlined
def has_to_yield(lanes: Any, cars: Any, i: int, j: int) -> int:
    """``RegulatedRoad.respect_priorities``: the one of two cars that has to give way."""
    a, b = cars[i], cars[j]
    difference = lanes[a.lane].priority - lanes[b.lane].priority
    if difference != 0.0:
        return j if difference > 0.0 else i
    dx, dy = b.x - a.x, b.y - a.y
    in_front, in_front_of_other = a.cos * dx + a.sin * dy, -b.cos * dx - b.sin * dy
    return i if in_front > in_front_of_other else j


@compiled
def regulate(lanes: Any, cars: Any, places: Any, rules: Any, before_ego: int) -> None:
    """Release the cars that gave way, at the speed limit of their lane, and find those that have to give way now."""
    for i in range(len(cars)):
        if cars[i].yields:
            cars[i].target_speed, cars[i].yields = lanes[cars[i].lane].limit, False
    predicted = np.empty((len(cars), SAMPLES, 3))
    predict(lanes, cars, places, predicted)
    if rules.is_steered:
        predict_steered(cars, rules, np.empty_like(cars[:1]), np.empty(1), predicted)
    for i in range(len(cars)):
        for j in range(i + 1, len(cars)):
            if will_meet(predicted[i], predicted[j]):
                # of two cars face to face on a straight way it is the second one, in highway-env's order of vehicles
                is_reversed = i == 0 and j <= before_ego
                loser = has_to_yield(lanes, cars, j, i) if is_reversed else has_to_yield(lanes, cars, i, j)
                if not cars[loser].is_ego and cars[loser].gives_way:
                    cars[loser].target_speed, cars[loser].yields = 0.0, True
