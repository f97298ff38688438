"""The sub-steps of highway-env (``AbstractEnv._simulate``, ``Road.act``, ``Road.step``), one policy step per call."""

import math
from typing import Any, NamedTuple

import numpy as np

from sumo_env.replica.compiled import compiled, inlined
from sumo_env.replica.contacts import collide, ego_ttc
from sumo_env.replica.driving import drive, follow_road, free_roads
from sumo_env.replica.geometry import closest_lane, locate, no_places, on_axis
from sumo_env.replica.give_way import regulate
from sumo_env.replica.motion import KP_ACCELERATION, move, steer
from sumo_env.replica.risk import push, return_from_swerve, start_events
from sumo_env.scene import MAX_SPEED
from sumo_env.traffic.scenario import EXIT_LENGTH, SPAWN_DISTANCE

# Of this type and no literal, for which Numba would compile all that reads it once more.
NOBODY: Any = np.int64(0)
# Rows of a frame of a trace, shape (frames, 6, cars):
X, Y, SPEED, HEADING, CRASHED, IN_EVENT = range(6)


class Rules(NamedTuple):
    """What differs between the tasks, the variants and the types of action."""

    along_path: bool  # distances beyond the end of a lane are measured along the path (the variant ``path``)
    is_two_way: bool  # cut-ins are swerves into the oncoming lane
    regulation_interval: int  # sub-steps between two applications of right of way, 0 but at the intersection
    dt: float  # length of a sub-step [s]
    ego_contacts: bool = False  # contacts of the others with each other are not looked at (highway-fast)
    substeps: int = 0  # of a policy step
    warmed_up: int = 0  # sub-steps of the warm-up before the episode
    is_steered: bool = False  # the ego's acceleration and steering are commanded, not its targets
    is_dynamical: bool = False  # its tyres slip
    slowest: float = -MAX_SPEED  # of the ego, see `motion.move` [m/s]
    fastest: float = MAX_SPEED


@inlined
def hold(ego: Any, acceleration: float, steering: float) -> None:
    """``ContinuousAction.act``: what the ego does from now on; to the others it is a car that wants to stand."""
    ego.acceleration, ego.steering, ego.target_speed = acceleration, steering, 0.0


@inlined
def act(lanes: Any, cars: Any, places: Any, rules: Any) -> None:
    """``Road.act``: all drivers decide in turn, so that the decisions of one are seen by those after it."""
    free_roads(lanes, cars, places)
    for i in range(len(cars)):
        car = cars[i]
        if car.is_ego and rules.is_steered:  # ``Vehicle.act``: as before
            continue
        if car.is_ego:  # ``MDPVehicle.act``
            follow_road(lanes, car, places.s[car.target, i])
            car.acceleration = KP_ACCELERATION * (car.target_speed - car.speed)
        elif not (car.crashed or car.is_obstacle):
            drive(lanes, cars, places, rules, i)
    steer(lanes, cars, places, rules)


@inlined
def step(lanes: Any, cars: Any, places: Any, rules: Any, count: int, before_ego: Any) -> None:
    """``Road.step``.

    count: number of this sub-step since the first vehicles were placed, from 1; before_ego: cars that highway-env has
    in its list before the ego, for the order of pairs.
    """
    if rules.regulation_interval > 0 and count % rules.regulation_interval == 0:
        regulate(lanes, cars, places, rules, before_ego)
    move(cars, places.room[0], rules, rules.dt)
    for i in range(len(cars)):
        return_from_swerve(cars[i], rules.dt)
    locate(lanes, cars, places)
    for i in range(len(cars)):
        cars[i].lane = closest_lane(lanes, places, i, cars[i].heading, cars[i].lane)
        if rules.is_steered and cars[i].is_ego:  # it steers for no lane
            cars[i].target = cars[i].lane
    collide(cars, places, rules, before_ego)


@compiled
def staying(lanes: Any, cars: Any) -> Any:
    """``IntersectionEnv._clear_vehicles``: which cars stay; all but the ego leave near the end of an exit."""
    stays = np.ones(len(cars), np.bool_)
    for i in range(len(cars)):
        lane = lanes[cars[i].lane]
        if lane.is_exit and not cars[i].is_ego:
            stays[i] = on_axis(lane, cars[i].x, cars[i].y)[0] < lane.length - EXIT_LENGTH
    return stays


@inlined
def is_free(cars: Any, x: float, y: float, distance: float) -> bool:
    """Is no centre of a car nearer to (x, y) [m] than a distance [m]?"""
    for i in range(len(cars)):  # noqa: SIM110 (numba compiles no generators)
        if math.hypot(cars[i].x - x, cars[i].y - y) < distance:
            return False
    return True


@compiled
def warm_up(lanes: Any, cars: Any, rules: Any, frames: int) -> None:
    """Drive the first vehicles for some sub-steps without an ego and without risk events."""
    places = no_places(lanes, cars)
    locate(lanes, cars, places)
    for frame in range(frames):
        act(lanes, cars, places, rules)
        step(lanes, cars, places, rules, frame + 1, NOBODY)


@compiled
def let_out_and_in(lanes: Any, cars: Any, arrivals: Any, episode: Any) -> None:
    """Cars leave, and those of the arrivals come that have no other within 15 m."""
    stays, count = staying(lanes, cars[: episode.cars]), 0
    for i in range(len(stays)):
        if stays[i]:
            if count < i:
                cars[count] = cars[i]
            count += 1
    while (
        episode.next_arrival < episode.arrivals
        and arrivals[episode.next_arrival].comes_after <= episode.steps
    ):
        fresh = arrivals[episode.next_arrival]
        episode.next_arrival += 1
        if is_free(cars[:count], fresh.x, fresh.y, SPAWN_DISTANCE):
            cars[count] = fresh
            count += 1
    episode.cars = count


@compiled
def policy_step(lanes: Any, rules: Any, batch: Any, row: int, trace: Any) -> tuple[int, float, float]:
    """Drive one policy step of an episode of a `Batch`, whose state is changed.

    Args:
        lanes: records.
        rules: of the task.
        batch, row: the episode.
        trace: where the sub-steps are written down, shape (sub-steps, 6, room for cars), or nowhere (0, 6, 0).

    Returns:
        the frame in which the ego, the first car, crashed (-1: none), the least time to collision [s], and the distance
        that it covered [m].
    """
    episode = batch.episodes[row]
    if rules.regulation_interval > 0 and episode.steps > 0:
        let_out_and_in(lanes, batch.cars[row], batch.arrivals[row], episode)
    cars, events = batch.cars[row, : episode.cars], batch.events[row, : episode.events]
    crash, least, distance, before_ego = -1, math.inf, 0.0, NOBODY
    for i in range(1, len(cars)):
        before_ego += cars[i].number < episode.first_arrival and not cars[i].is_ego
    places = no_places(lanes, cars)
    locate(lanes, cars, places)
    for frame in range(rules.substeps):
        steps = episode.steps * rules.substeps + frame
        time = steps * rules.dt
        episode.next_event = start_events(lanes, cars, places, rules, events, episode.next_event, time)
        distance += max(cars[0].speed, 0.0) * rules.dt
        act(lanes, cars, places, rules)
        push(cars, time, rules.dt)
        step(lanes, cars, places, rules, rules.warmed_up + steps + 1, before_ego)
        for i in range(len(cars) if len(trace) > 0 else 0):
            car = cars[i]
            trace[frame, X, i], trace[frame, Y, i] = car.x, car.y
            trace[frame, SPEED, i], trace[frame, HEADING, i] = car.speed, car.heading
            trace[frame, CRASHED, i] = 1.0 if car.crashed else 0.0
            trace[frame, IN_EVENT, i] = 1.0 if car.in_event else 0.0
        if not cars[0].crashed:
            least = min(least, ego_ttc(cars))
        elif crash < 0:
            crash = frame
    episode.steps += 1
    return crash, least, distance
