"""Lanes, cars and risk events as tables: numpy record arrays, one record each, which the kernels read and write.

A lane is called by its number, in highway-env's order of lanes; lanes beside each other have successive numbers, and
the number of the left one is also the number of their road.
"""

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from math import cos, sin
from typing import Any

import numpy as np

from sumo_env.networks.lanes import VEHICLE_LENGTH, CircularLane, Lane, Point, SineLane, StraightLane
from sumo_env.networks.roads import LaneIndex, Road
from sumo_env.replica.compiled import record_type
from sumo_env.replica.linear import TIME_WANTED, LinearDriver
from sumo_env.scene import is_obstacle
from sumo_env.traffic.drivers import Driver
from sumo_env.traffic.risk import RiskEvent
from sumo_env.traffic.scenario import EGO, VehicleSpec

Records = np.ndarray[Any, Any]  # a numpy record array of one of the types below

STRAIGHT, SINE, CIRCULAR = 0, 1, 2
CUT_IN, PUSH = 0, 1
NONE = -1  # no lane, no plan, no car
LONGEST_ROUTE = 14  # roads: an entry, its curve, once around the ring, an exit
MOST_JOINS = 8

LANE = record_type(
    [
        ("kind", "i8"),
        ("length", "f8"),  # [m]
        ("limit", "f8"),  # speed limit [m/s]
        ("priority", "f8"),  # the larger one has right of way
        ("x", "f8"),  # start of a straight or sine lane, centre of a circular one [m]
        ("y", "f8"),
        ("cos", "f8"),  # of the heading of the axis of a straight or sine lane
        ("sin", "f8"),
        ("heading", "f8"),  # [rad]
        ("amplitude", "f8"),  # of a sine lane [m]
        ("pulsation", "f8"),  # [rad/m]
        ("phase", "f8"),  # [rad]
        ("radius", "f8"),  # of a circular lane [m]
        ("start_phase", "f8"),  # [rad]
        ("turn", "f8"),  # +1 to the right, -1 to the left
        ("road", "i8"),  # number of the left lane of this road
        ("abreast", "i8"),  # lanes of this road
        ("left", "i8"),  # the lane to the left that may be changed to, or NONE
        ("right", "i8"),
        ("start", "i8"),  # number of the node where the lane begins
        ("end", "i8"),
        ("is_exit", "?"),  # vehicles leave near its end (intersection)
        ("roads_after", "i8", (MOST_JOINS,)),  # roads that begin at its end, then NONE
        # The lane itself, the `following` lanes that a driver looks at beyond its end, and those before its start:
        ("joined", "i8", (MOST_JOINS,)),
        ("offset", "f8", (MOST_JOINS,)),  # where each of these begins, measured along this lane [m]
        ("following", "i8"),
    ]
)

DRIVER = [
    ("accel", "f8"),  # COMFORT_ACC_MAX [m/s2]
    ("decel", "f8"),  # -COMFORT_ACC_MIN [m/s2]
    ("jam_distance", "f8"),  # DISTANCE_WANTED, between centres [m]
    ("tau", "f8"),  # TIME_WANTED [s]
    ("delta", "f8"),  # DELTA []
    ("acc_max", "f8"),  # ACC_MAX: the acceleration is clipped to plus and minus this [m/s2]
    ("safe_braking", "f8"),  # LANE_CHANGE_MAX_BRAKING_IMPOSED [m/s2]
    ("min_gain", "f8"),  # LANE_CHANGE_MIN_ACC_GAIN [m/s2]
    ("gives_way", "?"),
]

LINEAR = [  # a driver of `sumo_env.replica.linear`
    ("is_linear", "?"),
    ("target_gain", "f8"),  # ACCELERATION_PARAMETERS
    ("approach_gain", "f8"),
    ("distance_gain", "f8"),
    ("heading_gain", "f8"),  # STEERING_PARAMETERS
    ("lateral_gain", "f8"),
]

SLIDING = [  # a steered ego whose tyres slip, see `motion.slide`
    ("lateral_speed", "f8"),  # [m/s]
    ("yaw_rate", "f8"),  # [rad/s]
]

PARAMETERS = [name for name, _ in DRIVER + LINEAR]  # of a driver

CAR = record_type(
    [
        ("number", "i8"),  # place among all vehicles of the scenario
        ("is_ego", "?"),
        ("x", "f8"),  # centre [m]
        ("y", "f8"),
        ("heading", "f8"),  # [rad]
        ("cos", "f8"),  # of the heading
        ("sin", "f8"),
        ("speed", "f8"),  # [m/s]
        ("lane", "i8"),  # that it is on
        ("target", "i8"),  # lane that it steers for
        ("target_speed", "f8"),  # [m/s]
        ("timer", "f8"),  # since the last decision of MOBIL [s]
        ("changes_lanes", "?"),
        ("is_obstacle", "?"),  # a box of the road, which stands
        ("yields", "?"),  # is stopping for others
        ("route", "i8", (LONGEST_ROUTE,)),  # roads, then NONE
        ("leg", "i8"),  # place in `route` of the road that the rest of the route begins with
        ("planned", "i8"),  # lane of that road which the route asks for, or NONE
        ("is_forced", "?"),  # a lane change of a risk event is under way
        ("swerve_left", "f8"),  # until a swerve into the oncoming lane ends [s]
        ("push", "f8"),  # acceleration of a sudden braking or surge, 0 for none [m/s2]
        ("push_end", "f8"),  # [s]
        ("push_way", "f8"),  # that has to be free for a surge [m]
        ("in_event", "?"),  # a risk event acts on it in this sub-step
        ("acceleration", "f8"),  # of this sub-step [m/s2]
        ("steering", "f8"),  # angle of the front wheels [rad]
        ("crashed", "?"),
        ("is_pushed_apart", "?"),  # has touched another car: will be moved by `apart` in the next sub-step
        ("apart_x", "f8"),  # [m]
        ("apart_y", "f8"),
        ("comes_after", "i8"),  # of an arrival: policy step
        *DRIVER,
        *LINEAR,
        *SLIDING,
    ]
)


def _letters(field: str) -> str:
    """The type of a field of CAR in a format of `struct`."""
    base, shape = CAR[field].base, CAR[field].shape
    return f"{shape[0] if shape else 1}{'q' if base == np.int64 else base.char}"


EVENT = record_type(
    [
        ("time", "f8"),  # [s]
        ("car", "i8"),  # `number` of the car
        ("kind", "i8"),  # CUT_IN or PUSH
        ("direction", "i8"),  # of a cut-in, -1 left or +1 right
        ("acceleration", "f8"),  # [m/s2]
        ("duration", "f8"),  # [s]
        ("way", "f8"),  # [m]
    ]
)


EPISODE = record_type(
    [
        ("cars", "i8"),  # that are there
        ("arrivals", "i8"),  # that come later
        ("next_arrival", "i8"),
        ("first_arrival", "i8"),  # cars of smaller numbers come before the ego in highway-env's list
        ("events", "i8"),
        ("next_event", "i8"),
        ("steps", "i8"),  # policy steps
        ("speed_index", "i8"),  # of the ego's target speed, in a batch
    ]
)


@dataclass(frozen=True, slots=True)
class Lanes:
    """The lanes of a road for the kernels."""

    table: Records
    exact: Records  # with the intersection's arms turned exactly, as `sumo_env` sees them (see `as_rotated`)
    names: tuple[LaneIndex, ...]  # highway-env's index of each lane
    numbers: dict[LaneIndex, int]


@lru_cache(maxsize=16)
def lanes_of(road: Road, connected: bool) -> Lanes:
    """The lanes of a road; `connected`: drivers look beyond the ends of their lane (``Road.neighbour_vehicles``)."""
    names = tuple(road.lanes)
    numbers = {name: number for number, name in enumerate(names)}
    roads = {name[:2]: numbers[name[0], name[1], 0] for name in names}
    nodes = {node: k for k, node in enumerate(dict.fromkeys(node for name in names for node in name[:2]))}

    def beside(start: str, end: str, lane: int) -> int:
        """The lane of this id, or the left one where the road has none."""
        return numbers.get((start, end, lane), roads[start, end])

    table = np.zeros(len(names), LANE)
    for number, ((start, end, lane), curve) in enumerate(road.lanes.items()):
        record = table[number]
        _write_geometry(record, curve)
        record["road"], record["abreast"] = roads[start, end], road.count(start, end)
        for side, way in ((-1, "left"), (1, "right")):
            other = road.beside((start, end, lane), side)
            record[way] = NONE if other is None else numbers[other]
        record["start"], record["end"] = nodes[start], nodes[end]
        record["is_exit"] = road.clears_exits and end in road.ends
        after = [pair for pair in roads if pair[0] == end]
        before = [pair for pair in roads if pair[1] == start]
        record["roads_after"] = _filled([roads[pair] for pair in after])
        following = [beside(*pair, lane) for pair in after] if connected else []
        preceding = [beside(*pair, lane) for pair in before] if connected else []
        record["following"] = len(following)
        record["joined"] = _filled([number, *following, *preceding])
        begins = [0.0, *[curve.length] * len(following), *(-road.lane(names[k]).length for k in preceding)]
        record["offset"][: len(begins)] = begins
    turned = table.copy()
    for record, curve in zip(turned, as_rotated(road).lanes.values(), strict=True):
        _write_geometry(record, curve)
    return Lanes(turned, table, names, numbers)


@lru_cache(maxsize=16)
def as_rotated(road: Road) -> Road:
    """The intersection with lanes as highway-env computes them: the southern arm's, turned by a matrix.

    That is 1e-14 m from the exact places. It matters because highway-env's steering is unstable below 0.7 m/s: it
    multiplies what a car is away from the middle of its lane, be it a rounding error, until it zigzags.
    """

    if not road.turned_by_matrix:
        return road

    def turned(point: Point, corner: int) -> Point:
        angle = np.radians(90 * corner)
        matrix = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        x, y = point
        for _ in range(-corner % 4):  # back to the southern arm, exactly
            x, y = -y, x
        x, y = matrix @ np.array([x, y])
        return float(x), float(y)

    lanes: dict[LaneIndex, Lane] = {}
    for name, lane in road.lanes.items():
        # an exit is built with the arm to its right
        corner = (int(name[0][-1]) + name[0].startswith("il")) % 4
        if isinstance(lane, CircularLane):
            lanes[name] = replace(lane, center=turned(lane.center, corner))
        elif isinstance(lane, StraightLane):
            lanes[name] = replace(lane, start=turned(lane.start, corner), end=turned(lane.end, corner))
    return Road(road.name, lanes, arguments=road.arguments)


def _filled(numbers: list[int], size: int = MOST_JOINS) -> list[int]:
    return numbers + [NONE] * (size - len(numbers))


def _write_geometry(record: Any, lane: Lane) -> None:
    record["length"], record["limit"], record["priority"] = lane.length, lane.speed_limit, lane.priority
    if isinstance(lane, CircularLane):
        record["kind"], record["radius"], record["start_phase"] = CIRCULAR, lane.radius, lane.start_phase
        record["x"], record["y"] = lane.center
        record["turn"] = 1.0 if lane.clockwise else -1.0
    elif isinstance(lane, StraightLane):
        record["kind"], record["heading"] = STRAIGHT, lane.heading
        record["x"], record["y"] = lane.start
        length = lane.length
        record["cos"], record["sin"] = ((b - a) / length for a, b in zip(lane.start, lane.end, strict=True))
        if isinstance(lane, SineLane):
            record["kind"] = SINE
            record["amplitude"], record["pulsation"] = lane.amplitude, lane.pulsation
            record["phase"] = lane.phase
    else:
        raise TypeError(f"the replica drives on no {type(lane).__name__}: other networks need SUMO")


@lru_cache(maxsize=1024)
def route_of(road: Road, lane: LaneIndex, destination: str | None) -> tuple[int, ...]:
    """The roads of ``ControlledVehicle.plan_route_to``, by number."""
    if destination is None:
        return (NONE,) * LONGEST_ROUTE
    nodes = (lane[0], *(road.route(lane[1], destination) or lane[1:2]))
    numbers = lanes_of(road, False).numbers
    return tuple(_filled([numbers[a, b, 0] for a, b in pairwise(nodes)], LONGEST_ROUTE))


@lru_cache(maxsize=4096)
def _rest(
    road: Road, lane: LaneIndex, goal: str | None, changes_lanes: bool, is_obstacle: bool, driver: Driver
) -> bytes:
    """What `cars_of` writes behind the timer, the same in many episodes."""
    way = *route_of(road, lane, goal), 0, NONE if goal is None else lane[2]
    nothing = False, 0.0, 0.0, 0.0, 0.0, False, 0.0, 0.0, False, False, 0.0, 0.0, 0
    follows = driver.accel, driver.decel, driver.min_gap + VEHICLE_LENGTH, driver.tau, driver.delta
    changes = driver.emergency_decel, driver.safe_braking, driver.min_gain, driver.gives_way
    rest = [0] * len(LINEAR + SLIDING)
    return REST.pack(changes_lanes, is_obstacle, False, *way, *nothing, *follows, *changes, *rest)


def cars_of(road: Road, specs: Iterable[VehicleSpec]) -> Records:
    """Vehicles as they are at the start of their lives: records of CAR, numbered in this order."""
    numbers, rows = lanes_of(road, False).numbers, bytearray()
    for number, spec in enumerate(specs):
        id, lane, _, x, y, heading, speed, wanted, goal, driver, changes_lanes, timer, _ = spec
        place = numbers[lane]
        rows += POSE.pack(
            number, id == EGO, x, y, heading, cos(heading), sin(heading), speed, place, place, wanted, timer
        )
        rows += _rest(road, lane, goal, changes_lanes, is_obstacle(id), driver)
    return np.frombuffer(rows, CAR)


# Two parts of a record as C has it, which Python packs four times as fast as numpy writes it.
NAMES = CAR.names or ()
POSE, REST = (struct.Struct("@" + "".join(map(_letters, names)) + "0q") for names in (NAMES[:12], NAMES[12:]))


def as_bytes(records: Records) -> Records:
    """Records that are copied up to fifty times as fast: of others numpy copies field by field."""
    return records.view(np.dtype((np.void, records.itemsize)))


def joined(first: Records, second: Records) -> Records:
    """Copies of cars, after one another."""
    return np.concatenate((as_bytes(first), as_bytes(second))).view(CAR)


def chosen(records: Records, rows: Any) -> Records:
    """Copies of some records; rows: anything that numpy takes as an index, such as ``slice(None)`` for all of them."""
    return np.array(as_bytes(records)[rows]).view(records.dtype)


def drive_linearly(car: Any, driver: LinearDriver) -> None:
    """Give a car the parameters of a LinearVehicle."""
    car["is_linear"], car["tau"] = True, TIME_WANTED
    car["target_gain"], car["approach_gain"], car["distance_gain"] = driver.acceleration
    car["heading_gain"], car["lateral_gain"] = driver.steering


def events_of(events: Iterable[RiskEvent], numbers: dict[str, int]) -> Records:
    """Risk events as records of EVENT; `numbers`: of the cars, by id."""
    rows = []
    for event in events:
        kind = CUT_IN if event.kind_on("the replica") == "cut-in" else PUSH
        how = event.direction, event.accel, event.duration, event.way
        rows.append((event.time, numbers[event.vehicle], kind, *how))
    return np.array(rows, EVENT)
