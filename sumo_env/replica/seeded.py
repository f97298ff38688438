"""Seeded episodes drawn in compiled code: what `Task.scenario` and `Replica.load` give, to the bit.

numba drives numpy's generators; one of them is taken to the beginning of every stream by writing to its memory. Not
here: the intersection, whose traffic warms up.
"""

from __future__ import annotations

import ctypes
import math
import zlib
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from sumo_env.config import Config
from sumo_env.replica import tables
from sumo_env.replica.compiled import AS_PYTHON, compiled, inlined
from sumo_env.replica.geometry import from_lane, heading_at, local_coordinates, position
from sumo_env.replica.tables import NONE
from sumo_env.tasks import highway, roundabout, two_way, u_turn
from sumo_env.tasks.base import Task
from sumo_env.traffic.drivers import POOL, DriverPool
from sumo_env.traffic.risk import RiskEvent, pushes

# Tasks whose traffic `draw` draws: their laws stand here a second time. A task derived from one may have another law.
KNOWN = (highway.Highway, two_way.TwoWay, roundabout.Roundabout, u_turn.UTurn)
HIGHWAY, TWO_WAY, ROUNDABOUT, U_TURN = range(len(KNOWN))
PLACES, DRIVEN, EVENTS = (zlib.crc32(name) for name in (b"scenario", b"drivers", b"risk events"))
# of numpy's SeedSequence and PCG64
INIT_A, TIMES_A, INIT_B, TIMES_B = map(np.int64, (0x43B0D7E5, 0x931E8875, 0x8B51F9DD, 0x58F38DED))
MIX_L, MIX_R, LOW = map(np.int64, (0xCA01F9DD, 0x4973F715, 0xFFFFFFFF))
TIMES_HIGH, TIMES_LOW = np.uint64(2549297995355413924), np.uint64(4865540595714422341)
ONE, HALF, ALL_BUT_ONE = map(np.uint64, (1, 32, 63))


class Draws(NamedTuple):
    """What all drawn episodes of a batch have in common. A spot is a lane, s [m] and a speed [m/s]."""

    task: int  # place in KNOWN
    lanes: tables.Records
    ego: tables.Records  # shape (1,)
    drivers: tables.Records  # cars of the pools' drivers: of drawn and of fixed exponents, shape (2, POOL)
    is_fixed: bool  # whether the exponents of the task's drivers are
    routes: np.ndarray  # by goal (the ego's first), lane and leg
    spots: np.ndarray  # of the ego, and of others but for a deviation, shape (n, 3)
    roads: np.ndarray  # first lane and number of lanes of the roads of further cars, shape (n, 2)
    counts: tuple[int, int]  # other vehicles in the ego's direction, and in the opposite one
    chosen: int  # the ego's lane, or the goal of the first of the others; NONE where it is drawn
    numbers: tuple[float, float, float]  # of the law
    speed_index: int  # of the ego
    dose: float
    duration: float  # [s]
    rates: tuple[float, float, float]  # of the kinds of events at dose 1 [1/s]
    events: tables.Records  # one of each kind, shape (3,)


def draws_of(task: Task, config: Config, lanes: tables.Lanes, speed_index: int) -> Draws | None:
    """How the episodes of a task are drawn under a resolved configuration; None where Python draws them."""
    if type(task) not in KNOWN or not has_known_memory():
        return None
    road, number, rates, dose = task.road(config), lanes.numbers, task.risk_rates, float(config["risk"])
    ego = task.ego(config, road, np.random.default_rng())
    other = ego._replace(id="v", changes_lanes=task.name != "two-way")
    cars = [
        tables.cars_of(road, [other._replace(driver=driver) for driver in pool.drivers])
        for pool in (DriverPool(task.car_following, dose, fixed, task.risk_ranges) for fixed in (False, True))
    ]
    goals, spots, roads = [ego.destination], [(ego.lane, ego.s, ego.speed)], np.zeros((0, 2), np.int64)
    chosen, numbers = None, (0.0, 0.0, 0.0)
    if task.name == "highway":
        chosen, shrink = config["initial_lane_id"], math.exp(-5.0 / 40.0 * config["lanes_count"])
        numbers = float(config["ego_spacing"]), 1.0 / config["vehicles_density"], shrink
    elif task.name == "two-way":
        numbers = float(config["road_length"]) - 90.0, 280.0, 0.0
        spots.append((two_way.ONCOMING, 0.0, 0.0))
    elif task.name == "roundabout":
        chosen, goals = config["incoming_vehicle_destination"], [*goals, *roundabout.DESTINATIONS]
        spots += [(lane, s, 0.0) for lane, s in roundabout.SLOTS]
        roads = np.array([(number[start, end, 0], abreast) for start, end, abreast in roundabout.EXTRA_ROADS])
    else:
        spots += u_turn.SLOTS
    kinds = [RiskEvent(0.0, "v", kind, **more) for kind, more in pushes(rates).items()]
    return Draws(
        task=KNOWN.index(type(task)),
        lanes=lanes.table,
        ego=tables.cars_of(road, [ego]),
        drivers=np.stack(cars),
        is_fixed=task.fixed_delta,
        routes=np.array([[tables.route_of(road, lane, goal) for lane in lanes.names] for goal in goals]),
        spots=np.array([(number[lane], s, speed) for lane, s, speed in spots], float),
        roads=roads,
        counts=(int(config["vehicles_count"]), int(config.get("oncoming_vehicles_count", 0))),
        chosen=NONE if chosen is None else int(chosen),
        numbers=numbers,
        speed_index=speed_index,
        dose=dose,
        duration=float(config["duration"]),
        rates=(rates.cut_in, rates.brake, rates.surge),
        events=tables.events_of([RiskEvent(0.0, "v", "cut-in"), *kinds], {"v": 0}),
    )


def begin(draws: Draws, batch: Any, rows: np.ndarray, seeds: np.ndarray) -> np.ndarray:
    """Begin the episodes of these seeds in these rows of a batch.

    Returns which of them there was room for, bool of shape (n,).
    """
    rng, done = np.random.Generator(np.random.PCG64(0)), np.zeros(len(rows), np.bool_)
    draw(draws, rng, _memory(rng), batch, rows, seeds, done)
    return done


# -- streams ------------------------------------------------------------------------------------------------------


def _memory(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Of a PCG64: its state and increment, each as two halves, the low one first; whether half a number is left."""
    address = rng.bit_generator.ctypes.state_address
    numbers = ctypes.c_uint64.from_address(address).value
    state = np.ctypeslib.as_array((ctypes.c_uint64 * 4).from_address(numbers))
    return state, np.ctypeslib.as_array((ctypes.c_uint32 * 1).from_address(address + 8))


@cache
def has_known_memory() -> bool:
    """Whether numpy keeps a PCG64 in the memory as `_memory` reads it, and the kernels are compiled."""
    rng = np.random.default_rng(1)
    low, high, *_ = map(int, _memory(rng)[0])
    return not AS_PYTHON and low + (high << 64) == rng.bit_generator.state["state"]["state"]


@inlined
def hashed(value: Any, key: Any, factor: Any) -> Any:
    """A step of SeedSequence's hash: the value and the next key."""
    value, key = (value ^ key) & LOW, (key * factor) & LOW
    value = (value * key) & LOW
    return value ^ (value >> 16), key


@compiled
def go_to(memory: Any, seed: int, purpose: int) -> None:
    """Set a PCG64 to the beginning of ``streams.stream(seed, purpose)``."""
    (state, buffer), pool, key = memory, np.zeros(4, np.int64), INIT_A
    pool[0], pool[1] = seed, purpose
    for k in range(4):
        pool[k], key = hashed(pool[k], key, TIMES_A)
    for source in range(4):
        for k in range(4):
            if source != k:
                value, key = hashed(pool[source], key, TIMES_A)
                value = (((pool[k] * MIX_L) & LOW) - ((value * MIX_R) & LOW)) & LOW
                pool[k] = value ^ (value >> 16)
    words, key = np.zeros(8, np.uint64), INIT_B
    for k in range(8):
        value, key = hashed(pool[k % 4], key, TIMES_B)
        words[k] = np.uint64(value)
    words[0::2] |= words[1::2] << HALF
    low, high = (words[6] << ONE) | ONE, (words[4] << ONE) | (words[6] >> ALL_BUT_ONE)
    state[2], state[3] = low, high
    a, b = low + words[2], high + words[0]
    b += np.uint64(a < low)
    # their product with the multiplier, modulo 2**128
    m = np.uint64(LOW)
    c, d, e, f = a & m, a >> HALF, TIMES_LOW & m, TIMES_LOW >> HALF
    middle = (c * e >> HALF) + (c * f & m) + (d * e & m)
    b = b * TIMES_LOW + a * TIMES_HIGH + d * f + (c * f >> HALF) + (d * e >> HALF) + (middle >> HALF)
    a = a * TIMES_LOW + low
    state[0], state[1] = a, b + high + np.uint64(a < low)
    buffer[0] = 0


# -- laws: `vehicles` of the tasks, the ego first -----------------------------------------------------------------


@compiled
def on_highway(draws: Any, rng: Any, places: Any) -> int:
    """Numbers: spacing of the ego, and of others, and what the lanes' number makes of it."""
    lanes, count, shrink = len(draws.lanes), draws.counts[0], draws.numbers[2]
    places[0, 0] = rng.integers(0, lanes) if draws.chosen == NONE else draws.chosen
    places[0, 1] = draws.numbers[0] * (12.0 + 1.0 * 25.0) * shrink * (3.0 + rng.uniform(0.9, 1.1))
    places[0, 2] = 25.0
    places[1 : count + 1, 0] = rng.integers(0, lanes, count)
    places[1 : count + 1, 2] = rng.uniform(21.0, 24.0, count)
    jitter = rng.uniform(0.9, 1.1, count)
    for k in range(1, count + 1):
        gap = draws.numbers[1] * (12.0 + 1.0 * places[k, 2]) * shrink * jitter[k - 1]
        places[k, 1] = places[k - 1, 1] + gap
    return count + 1


@compiled
def on_two_way(draws: Any, rng: Any, places: Any) -> int:
    """Numbers: the lengths of road that two columns have [m]."""
    (own, oncoming), spots = draws.counts, draws.spots
    first, count = own + 1, own + oncoming + 1
    places[0, :3] = spots[0]
    places[1:first, 0], places[first:count, 0] = spots[0, 0], spots[1, 0]
    places[1:first, 1] = two_way.column(rng, own, 70.0, 40.0, draws.numbers[0])
    places[first:count, 1] = two_way.column(rng, oncoming, 300.0, -100.0, draws.numbers[1])
    places[1:first, 2] = 24.0 + 2.0 * rng.normal(0.0, 1.0, own)
    places[first:count, 2] = np.maximum(20.0 + 5.0 * rng.normal(0.0, 1.0, oncoming), 0.0)
    return count


@compiled
def on_roundabout(draws: Any, rng: Any, places: Any) -> int:
    """The first cars have places of their own, the others are placed where there is room."""
    spots, count = draws.spots, draws.counts[0] + 1
    places[0, :3] = spots[0]
    for k in range(1, count):
        goal = rng.integers(0, 3)
        places[k, 3] = 1 + (draws.chosen if k == 1 and draws.chosen != NONE else goal)
        if k < len(spots):
            places[k, 0], places[k, 1] = spots[k, 0], spots[k, 1] + 2.0 * rng.normal()
        elif not has_found_room(draws, rng, places, k):
            return k
        places[k, 2] = 16.0 + 2.0 * rng.normal()
    return count


@compiled
def has_found_room(draws: Any, rng: Any, places: Any, k: int) -> bool:
    """`roundabout._free_place` for car `k`."""
    lanes = draws.lanes
    for _ in range(100):
        road = draws.roads[rng.integers(0, len(draws.roads))]
        number = road[0] + rng.integers(0, road[1])
        s = rng.uniform(5.0, max(5.0, lanes[number].length - 5.0))
        x, y = position(lanes[number], s)
        is_free = True
        for j in range(k):
            other = position(lanes[int(places[j, 0])], places[j, 1])
            is_free = is_free and math.hypot(x - other[0], y - other[1]) >= roundabout.MIN_SPACING
        if is_free:
            places[k, 0], places[k, 1] = number, s
            return True
    return False


@compiled
def on_u_turn(draws: Any, rng: Any, places: Any) -> int:
    """Every car has a place of its own."""
    count = draws.counts[0] + 1
    places[:count, :3] = draws.spots[:count]
    for k in range(1, count):
        places[k, 1] += rng.normal() * 2.0
        places[k, 2] = max(places[k, 2] + rng.normal() * 2.0, 0.0)
    return count


# -- episodes -----------------------------------------------------------------------------------------------------


@compiled
def draw(draws: Any, rng: Any, memory: Any, batch: Any, rows: Any, seeds: Any, done: Any) -> None:
    """See `begin`."""
    for k in range(len(rows)):
        row, seed = rows[k], seeds[k]
        count = place(draws, rng, memory, batch.cars[row], seed)
        events = happen(draws, rng, memory, batch.events[row], count, seed)
        done[k] = count > 0 and events >= 0
        episode = batch.episodes[row]
        episode.cars, episode.events, episode.speed_index = count, events, draws.speed_index
        episode.arrivals, episode.next_arrival, episode.first_arrival = 0, 0, 0
        episode.next_event, episode.steps = 0, 0


@compiled
def place(draws: Any, rng: Any, memory: Any, cars: Any, seed: int) -> int:
    """All cars at the start; returns their number, or 0 where there is no room for them in the table."""
    if len(cars) <= draws.counts[0] + draws.counts[1]:
        return 0
    places = np.zeros((len(cars), 4))  # lane, s [m], speed [m/s] and goal
    go_to(memory, seed, PLACES)
    if draws.task == HIGHWAY:
        count = on_highway(draws, rng, places)
    elif draws.task == TWO_WAY:
        count = on_two_way(draws, rng, places)
    elif draws.task == ROUNDABOUT:
        count = on_roundabout(draws, rng, places)
    else:
        count = on_u_turn(draws, rng, places)
    go_to(memory, seed, DRIVEN)
    drawn = np.zeros(1, np.int64)
    for j in range(count):
        car, number, goal, s = cars[j], int(places[j, 0]), int(places[j, 3]), places[j, 1]
        if j == 0:
            cars[j] = draws.ego[0]
        else:
            if j % POOL == 1:
                drawn = rng.integers(0, POOL, POOL)
            is_fixed = draws.is_fixed and not (draws.task == U_TURN and j == 1)
            cars[j] = draws.drivers[int(is_fixed), drawn[(j - 1) % POOL]]
        car.x, car.y = position(draws.lanes[number], s)
        car.heading = heading_at(draws.lanes[number], s)
        if not 0.0 <= s <= draws.lanes[number].length:
            number = lane_at(draws.lanes, car.x, car.y, car.heading)
        car.number, car.lane, car.target = j, number, number
        car.speed, car.target_speed = places[j, 2], places[j, 2]
        car.cos, car.sin = math.cos(car.heading), math.sin(car.heading)
        car.timer = ((car.x + car.y) * math.pi) % 1.0
        for leg in range(tables.LONGEST_ROUTE):
            car.route[leg] = draws.routes[goal, number, leg]
        car.planned = NONE if car.route[0] == NONE else number - draws.lanes[number].road
    return count


@inlined
def lane_at(lanes: Any, x: float, y: float, heading: float) -> int:
    """`Road.closest_lane`."""
    best, least = 0, math.inf
    for number in range(len(lanes)):
        s, lat = local_coordinates(lanes[number], x, y)
        distance = from_lane(lanes[number], s, lat, heading)
        if distance < least:
            best, least = number, distance
    return best


@compiled
def happen(draws: Any, rng: Any, memory: Any, events: Any, count: int, seed: int) -> int:
    """`risk.draw_events`; returns their number, or NONE where there is no room for them in the table."""
    if draws.dose <= 0.0:
        return 0
    go_to(memory, seed, EVENTS)
    found = 0
    for car in range(1, count):
        for kind in range(len(draws.events)):
            for _ in range(rng.poisson(draws.rates[kind] * draws.duration)):
                time, keep, side = rng.random() * draws.duration, rng.random(), rng.random()
                if keep >= draws.dose:
                    continue
                if found == len(events):
                    return NONE
                at = found
                while at > 0 and events[at - 1].time > time:
                    events[at] = events[at - 1]
                    at -= 1
                events[at] = draws.events[kind]
                events[at].time, events[at].car = time, car
                if kind == 0:
                    events[at].direction = -1 if side < 0.5 else 1
                found += 1
    return found
