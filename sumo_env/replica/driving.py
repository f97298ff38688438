"""What a driver decides: the next lane of the route, lane changes and acceleration (``IDMVehicle.act``).

Car following is the Intelligent Driver Model as highway-env has it (Treiber et al. 2000),

    a = A (1 - (v / v0)^delta - (d* / d)^2),    d* = d0 + v T + v (v - v_lead) / (2 sqrt(A B)),

where d is the distance of *centres* and d* has no lower bound. Lane changes are MOBIL's (Kesting et al. 2007) with
politeness 0; all accelerations in it, the new follower's as well, are those of the *deciding* driver's parameters.
"""

import math
from typing import Any

import numpy as np

from sumo_env.replica.compiled import inlined
from sumo_env.replica.geometry import beyond_ends, local_coordinates, not_zero, position
from sumo_env.replica.neighbours import distance_beyond, neighbours
from sumo_env.replica.numpy_loops import binary, each_pair, power
from sumo_env.replica.tables import NONE
from sumo_env.scene import VEHICLE_LENGTH

LANE_CHANGE_DELAY = 1.0  # [s] a decision of MOBIL is due when the timer exceeds it
MIN_SPEED = 1.0  # [m/s] below which nobody decides to change lane
REACHABLE = 8.0  # [m] from the centre line


# -- the route ----------------------------------------------------------------------------------------------------


@inlined
def nearest_of_road(lanes: Any, lane: int, road: int, x: float, y: float) -> tuple[int, float]:
    """``RoadNetwork.next_lane_given_next_road``: the lane of the next road, and its distance to (x, y) [m]."""
    first, last = road, road + lanes[road].abreast
    if lanes[road].abreast == lanes[lane].abreast:  # the lane is kept
        first = road + lane - lanes[lane].road
        last = first + 1
    best, least = first, math.inf
    for k in range(first, last):
        s, lat = local_coordinates(lanes[k], x, y)
        distance = beyond_ends(lanes[k], s, lat)
        if distance < least:
            best, least = k, distance
    return best, least


@inlined
def next_lane(lanes: Any, car: Any, s: float) -> int:
    """``RoadNetwork.next_lane`` after the lane that a car steers for, which it has driven for `s` [m]."""
    lane = lanes[car.target]
    if car.leg < len(car.route) and car.route[car.leg] == lane.road:
        car.leg += 1
        car.planned = NONE
    x, y = position(lane, s)
    if car.leg < len(car.route):
        road = car.route[car.leg]
        if road != NONE and lanes[road].start == lane.end:
            return nearest_of_road(lanes, car.target, road, x, y)[0]
    best, least = car.target, math.inf
    for k in range(len(lane.roads_after)):
        if lane.roads_after[k] == NONE:
            break
        candidate, distance = nearest_of_road(lanes, car.target, lane.roads_after[k], x, y)
        if distance < least:
            best, least = candidate, distance
    return best


@inlined
def follow_road(lanes: Any, car: Any, s: float) -> None:
    """``ControlledVehicle.follow_road``: on the last half vehicle length of a lane, steer for the next one.

    s: where the car is on the lane that it steers for [m].
    """
    if s > lanes[car.target].length - VEHICLE_LENGTH / 2.0:
        car.target = next_lane(lanes, car, s)


# -- car following ------------------------------------------------------------------------------------------------


@inlined
def desired_gap(driver: Any, speed: float, faster: float) -> float:
    """``IDMVehicle.desired_gap``: the distance of centres [m] that `driver` wants at this speed [m/s].

    faster: how much faster than the leader [m/s].
    """
    braking = 2.0 * math.sqrt(driver.accel * driver.decel)
    return driver.jam_distance + speed * driver.tau + speed * faster / braking


@inlined
def approach(car: Any, leader: Any) -> float:
    """How much faster than a leader a car drives, along its own heading [m/s]."""
    faster_x = car.speed * car.cos - leader.speed * leader.cos
    faster_y = car.speed * car.sin - leader.speed * leader.sin
    return faster_x * car.cos + faster_y * car.sin


@inlined
def ahead(lanes: Any, places: Any, rules: Any, car: Any, i: int, j: int) -> tuple[float, bool]:
    """Distance of car `j` ahead of car `i` [m], and whether that is along the path beyond the end of the lane."""
    if rules.along_path:
        distance = distance_beyond(lanes, places, car.lane, car.target, i, j)
        if not math.isnan(distance):
            return distance, True
    return places.s[car.lane, j] - places.s[car.lane, i], False


@inlined
def linear_acceleration(lanes: Any, cars: Any, places: Any, rules: Any, who: int, i: int, j: int) -> float:
    """``LinearVehicle.acceleration`` [m/s2]; arguments as in `acceleration`."""
    car, driver = cars[i], cars[who]
    too_fast, too_near = 0.0, 0.0
    if j != NONE:
        distance, _ = ahead(lanes, places, rules, car, i, j)
        too_fast = min(cars[j].speed - car.speed, 0.0)
        too_near = min(distance - (driver.jam_distance + max(car.speed, 0.0) * driver.tau), 0.0)
    return (
        driver.target_gain * (car.target_speed - car.speed)
        + driver.approach_gain * too_fast
        + driver.distance_gain * too_near
    )


@inlined
def speed_ratio(lanes: Any, car: Any) -> float:
    """Speed of a car over that which its driver wants on its lane, (v / v0)."""
    return max(car.speed, 0.0) / not_zero(min(max(car.target_speed, 0.0), lanes[car.lane].limit))


@inlined
def free_roads(lanes: Any, cars: Any, places: Any) -> None:
    """Write the acceleration of every driver with nobody ahead, which all decisions of a sub-step share."""
    free, delta = places.free, places.room[0]
    for i in range(len(cars)):
        free[i], delta[i] = speed_ratio(lanes, cars[i]), cars[i].delta
    each_pair(power, free, delta)
    for i in range(len(cars)):
        free[i] = cars[i].accel * (1.0 - free[i])


@inlined
def acceleration(lanes: Any, cars: Any, places: Any, rules: Any, who: int, i: int, j: int) -> float:
    """``IDMVehicle.acceleration`` [m/s2] of car `i` behind car `j` by the parameters of driver `who`; NONE: nobody.

    The distance and speed of a leader beyond the end of the lane are projected on the lane and heading of the follower
    or, by ``rules.along_path``, measured along the path.
    """
    if i == NONE or cars[i].is_obstacle:
        return 0.0
    car, driver = cars[i], cars[who]
    if driver.is_linear:
        return linear_acceleration(lanes, cars, places, rules, who, i, j)
    result = places.free[i]
    if who != i:
        result = driver.accel * (1.0 - binary(power, speed_ratio(lanes, car), driver.delta))
    if j == NONE:
        return result
    distance, is_beyond = ahead(lanes, places, rules, car, i, j)
    faster = car.speed - cars[j].speed if is_beyond else approach(car, cars[j])
    ratio = desired_gap(driver, car.speed, faster) / not_zero(distance)
    return result - driver.accel * (ratio * ratio)


# -- lane changes -------------------------------------------------------------------------------------------------


@inlined
def is_reachable(lane: Any, s: float, lat: float) -> bool:
    """``AbstractLane.is_reachable_from`` of the point (s, lat) [m]."""
    return abs(lat) <= REACHABLE and 0.0 <= s < lane.length + VEHICLE_LENGTH


@inlined
def is_taken(cars: Any, places: Any, i: int) -> bool:
    """Is a car ahead of `i`, closer than `i` likes and not there yet, changing to the lane that `i` is changing to?"""
    car = cars[i]
    for j in range(len(cars)):
        if j != i and cars[j].target == car.target and cars[j].lane != car.target:
            distance = places.s[car.lane, j] - places.s[car.lane, i]
            if 0.0 < distance < desired_gap(car, car.speed, approach(car, cars[j])):
                return True
    return False


@inlined
def mobil(lanes: Any, cars: Any, places: Any, rules: Any, i: int, lane: int) -> bool:
    """``IDMVehicle.mobil``: is a change of car `i` to `lane` safe, and either planned or worth it?"""
    car = cars[i]
    front, rear = neighbours(lanes, places, i, lane)
    if acceleration(lanes, cars, places, rules, i, rear, i) < -car.safe_braking:
        return False
    after = acceleration(lanes, cars, places, rules, i, i, front)
    if car.planned != NONE:  # the route asks for a lane
        road, here = lanes[car.target].road, car.target - lanes[car.target].road
        if np.sign(lane - road - here) != np.sign(car.planned - here):
            return False
        return after >= -car.safe_braking
    old_front = neighbours(lanes, places, i, car.lane)[0]
    before = acceleration(lanes, cars, places, rules, i, i, old_front)
    return after - before >= car.min_gain


@inlined
def change_lane(lanes: Any, cars: Any, places: Any, rules: Any, i: int) -> None:
    """``IDMVehicle.change_lane_policy``: decide by MOBIL, or give up a change that another driver makes too."""
    car = cars[i]
    lane = lanes[car.lane]
    if car.lane != car.target:
        if lane.road == lanes[car.target].road and is_taken(cars, places, i):
            car.target = car.lane
        return
    if car.timer <= LANE_CHANGE_DELAY:
        return
    car.timer = 0.0
    for new in (lane.left, lane.right):
        if new == NONE:
            continue
        reachable = is_reachable(lanes[new], places.s[new, i], places.lat[new, i])
        if reachable and abs(car.speed) >= MIN_SPEED and mobil(lanes, cars, places, rules, i, new):
            car.target = new


# -- all together -------------------------------------------------------------------------------------------------


@inlined
def drive(lanes: Any, cars: Any, places: Any, rules: Any, i: int) -> None:
    """``IDMVehicle.act`` but for the steering: writes the car's target lane and acceleration."""
    car = cars[i]
    follow_road(lanes, car, places.s[car.target, i])
    if car.changes_lanes:
        car.is_forced = car.is_forced and car.lane != car.target
        if not car.is_forced:
            change_lane(lanes, cars, places, rules, i)
    front = neighbours(lanes, places, i, car.lane)[0]
    wanted = acceleration(lanes, cars, places, rules, i, i, front)
    if car.lane != car.target:
        front = neighbours(lanes, places, i, car.target)[0]
        wanted = min(wanted, acceleration(lanes, cars, places, rules, i, i, front))
    car.acceleration = min(max(wanted, -car.acc_max), car.acc_max)
