"""What risky drivers do: cut-ins, sudden braking and surges (`sumo_env.traffic.risk.RiskEvent`), and what they look at.

The same events, by the same rules, as `experiments.backends.highway_env` starts among highway-env's vehicles.
"""

from typing import Any

from sumo_env.contacts import rectangles
from sumo_env.replica.compiled import inlined
from sumo_env.replica.geometry import heading_at, position
from sumo_env.replica.tables import CUT_IN, NONE
from sumo_env.traffic.risk import CUT_IN_GAP, HALF_CORRIDOR, LOOKED_AT, SWERVE_TIME

OWN_LANE, ONCOMING_LANE = 1, 0  # of the two-way road, both driven to the east
ROUNDING = 1e-9  # [s] of sums of steps

_distance = inlined(rectangles.distance)


@inlined
def has_room(lanes: Any, cars: Any, places: Any, i: int, lane: int) -> bool:
    """Would car `i`, moved straight sideways to the middle of `lane`, be at least CUT_IN_GAP from everybody else?"""
    s = places.s[lane, i]
    x, y = position(lanes[lane], s)
    there = (x, y, cars[i].speed, heading_at(lanes[lane], s))
    for j in range(len(cars)):
        other = cars[j]
        if j == i or abs(other.x - x) + abs(other.y - y) > LOOKED_AT:
            continue
        if _distance(there, (other.x, other.y, other.speed, other.heading)) < CUT_IN_GAP:
            return False
    return True


@inlined
def has_free_way(cars: Any, i: int) -> bool:
    """Is no centre of another car in the straight corridor ahead of car `i` that its surge needs?"""
    car = cars[i]
    c, s = car.cos, car.sin
    for j in range(len(cars)):
        dx, dy = cars[j].x - car.x, cars[j].y - car.y
        if 0.0 < dx * c + dy * s < car.push_way and abs(dy * c - dx * s) < HALF_CORRIDOR:
            return False
    return True


@inlined
def cut_in(lanes: Any, cars: Any, places: Any, i: int, direction: int) -> None:
    """Change to the lane on this side, or the other one, whatever MOBIL says; only where there is room."""
    car = cars[i]
    beside = lanes[car.target].left, lanes[car.target].right
    for side in (direction, -direction):
        new = beside[0] if side < 0 else beside[1]
        if new != NONE and has_room(lanes, cars, places, i, new):
            car.target, car.is_forced = new, True
            return


@inlined
def swerve(lanes: Any, cars: Any, places: Any, i: int) -> None:
    """On the two-way road: drive in the oncoming lane for SWERVE_TIME; only from the middle of one's own."""
    car = cars[i]
    if car.lane == car.target == OWN_LANE and has_room(lanes, cars, places, i, ONCOMING_LANE):
        car.target, car.swerve_left = ONCOMING_LANE, SWERVE_TIME


@inlined
def return_from_swerve(car: Any, dt: float) -> None:
    """Steer back for one's own lane when a swerve is over; called after every step of `dt` [s]."""
    if car.swerve_left > 0.0:
        car.swerve_left -= dt
        if car.swerve_left <= ROUNDING:
            car.target, car.swerve_left = OWN_LANE, 0.0


@inlined
def start_events(lanes: Any, cars: Any, places: Any, rules: Any, events: Any, first: int, time: float) -> int:
    """Start the events from number `first` on that are due at `time` [s]; returns the number of the next one.

    Events of cars that have left or crashed are dropped.
    """
    while first < len(events) and events[first].time <= time + ROUNDING:
        event = events[first]
        first += 1
        for i in range(len(cars)):
            car = cars[i]
            if car.number != event.car or car.crashed:
                continue
            if event.kind != CUT_IN:
                car.push, car.push_end, car.push_way = event.acceleration, time + event.duration, event.way
            elif rules.is_two_way:
                swerve(lanes, cars, places, i)
            else:
                cut_in(lanes, cars, places, i, event.direction)
    return first


@inlined
def push(cars: Any, time: float, dt: float) -> None:
    """Sudden braking and surges on top of what the drivers want: changes the cars' accelerations.

    Marks the cars on which an event acts, cut-ins included; a surge that pauses does not act.
    """
    for i in range(len(cars)):
        car = cars[i]
        car.in_event = not car.crashed and (car.is_forced or car.swerve_left > 0.0)
        if car.push == 0.0:
            continue
        if time >= car.push_end - ROUNDING:
            car.push = 0.0
        elif car.crashed:
            continue
        elif car.push < 0.0:
            standstill = max(car.speed, 0.0) / dt  # nobody brakes into reverse
            car.acceleration, car.in_event = min(car.acceleration, -min(-car.push, standstill)), True
        elif has_free_way(cars, i):
            car.acceleration, car.in_event = max(car.acceleration, car.push), True
