"""What the ego sees, compiled: its place on the road, and highway-env's Kinematics table.

`KinematicsObservation` in highway-env, `sumo_env.spaces.observation.Kinematics` here; features that depend on routes
(cos_d, sin_d) are left to the latter.
"""

import math
from typing import Any

import numpy as np

from sumo_env.replica.compiled import compiled, inlined
from sumo_env.replica.geometry import heading_at, is_on, local_coordinates, wrapped
from sumo_env.scene import PERCEPTION_DISTANCE
from sumo_env.spaces.approach import APPROACH, approach
from sumo_env.spaces.observation import BEHIND, FEATURES, OFFSETS, POSE, Kinematics, TableForm

HALF_WIDTH = 2.0  # [m] of a lane
FIRST_OFFSET, FIRST_APPROACH = FEATURES.index(OFFSETS[0]), len(FEATURES)


def form_of(kinematics: Kinematics) -> TableForm | None:
    """The observation for `observe`; None if it has features that the kernel does not know."""
    return kinematics.form if set(kinematics.features) <= {*POSE, *OFFSETS, *APPROACH} else None


@inlined
def feature(lanes: Any, car: Any, k: int) -> float:
    """The value of a car that FEATURES[k] names."""
    if k >= FIRST_OFFSET:
        s, lat = local_coordinates(lanes[car.lane], car.x, car.y)
        return (s, lat, wrapped(car.heading - heading_at(lanes[car.lane], s)))[k - FIRST_OFFSET]
    velocity = car.speed * car.cos, car.speed * car.sin
    return (1.0, car.x, car.y, velocity[0], velocity[1], car.heading, car.cos, car.sin)[k]


@compiled
def observe(lanes: Any, cars: Any, form: Any, result: Any) -> None:
    """Write the Kinematics table of the ego, the first car: float32 of shape (rows, features), zero beyond the last."""
    ego, lane = cars[0], lanes[cars[0].lane]
    here = local_coordinates(lane, ego.x, ego.y)[0]
    rows, distances, seen = np.empty(form.rows, np.int64), np.empty(form.rows), 0
    for j in range(1, len(cars)):
        if math.hypot(cars[j].x - ego.x, cars[j].y - ego.y) >= PERCEPTION_DISTANCE:
            continue
        ahead = local_coordinates(lane, cars[j].x, cars[j].y)[0] - here
        if ahead <= BEHIND and (cars[j].is_obstacle or not form.see_behind):
            continue
        if cars[j].is_obstacle and not form.has_obstacles:
            continue
        place = seen
        while form.is_sorted and place > 0 and distances[place - 1] > abs(ahead):
            place -= 1
        if place >= form.rows - 1:
            continue
        seen = min(seen + 1, form.rows - 1)
        for k in range(seen - 1, place, -1):
            rows[k], distances[k] = rows[k - 1], distances[k - 1]
        rows[place], distances[place] = j, abs(ahead)
    result[:] = 0.0
    for row in range(seen + 1):
        car = ego if row == 0 else cars[rows[row - 1]]
        for k in range(len(form.features)):
            if form.features[k] >= FIRST_APPROACH:
                way = car.speed * car.cos - ego.speed * ego.cos, car.speed * car.sin - ego.speed * ego.sin
                value = approach(car.x - ego.x, car.y - ego.y, *way)[form.features[k] - FIRST_APPROACH]
            else:
                value = feature(lanes, car, form.features[k])
            if row > 0 and form.relative[k]:
                value -= feature(lanes, ego, form.features[k])
            elif row == 0:
                value -= form.origin[k]
            value = value * form.scale[k] + form.shift[k]
            result[row, k] = min(max(value, form.low[k]), form.high[k])


@inlined
def ego_place(lanes: Any, cars: Any) -> tuple[int, float, float, bool]:
    """The ego's lane, where it is on it (s and lat) [m], and whether it is on the road."""
    lane = lanes[cars[0].lane]
    s, lat = local_coordinates(lane, cars[0].x, cars[0].y)
    return cars[0].lane, s, lat, is_on(lane, s, lat) and abs(lat) <= HALF_WIDTH
