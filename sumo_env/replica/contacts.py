"""Contacts between cars: highway-env's test of rectangles now and after one step (``RoadObject.handle_collisions``).

And the time until the ego touches somebody, as it is measured for every simulator.
"""

import math
from typing import Any

from sumo_env.contacts import measures
from sumo_env.contacts.measures import HORIZON, TTC_RADIUS
from sumo_env.contacts.rectangles import DIAGONAL, HALF_LENGTH, HALF_WIDTH
from sumo_env.replica.compiled import inlined
from sumo_env.scene import OBSTACLE_SIZE

HALF_OBSTACLE = OBSTACLE_SIZE[0] / 2, OBSTACLE_SIZE[1] / 2
OBSTACLE_DIAGONAL = math.hypot(*OBSTACLE_SIZE)
_ego_ttc = inlined(measures.ego_ttc)


@inlined
def corners(car: Any) -> Any:
    """``RoadObject.polygon``: the four corners, x and y [m] each."""
    half_length, half_width = HALF_LENGTH, HALF_WIDTH
    if car.is_obstacle:
        half_length, half_width = HALF_OBSTACLE
    along_x, along_y = half_length * car.cos, half_length * car.sin
    across_x, across_y = half_width * car.sin, half_width * car.cos
    return (
        (-along_x + across_x + car.x, -along_y - across_y + car.y),
        (-along_x - across_x + car.x, -along_y + across_y + car.y),
        (along_x - across_x + car.x, along_y + across_y + car.y),
        (along_x + across_x + car.x, along_y - across_y + car.y),
    )


@inlined
def shadow(points: Any, x: float, y: float) -> tuple[float, float]:
    """Least and largest coordinate of the points along the direction (x, y)."""
    low, high = math.inf, -math.inf
    for k in range(4):
        place = points[k][0] * x + points[k][1] * y
        low, high = min(low, place), max(high, place)
    return low, high


@inlined
def interval_distance(low: float, high: float, other_low: float, other_high: float) -> float:
    """``utils.interval_distance``, negative if the intervals overlap."""
    return other_low - high if low < other_low else low - other_high


@inlined
def touch(first: Any, second: Any, dt: float) -> tuple[bool, bool, float, float]:
    """``utils.are_polygons_intersecting``: do cars touch now, will they after `dt` [s], and the way out of it.

    The way, x and y [m], moves the first car apart from the second; it means something only if they will touch.
    """
    a, b = corners(first), corners(second)
    move_x = first.speed * first.cos * dt - second.speed * second.cos * dt
    move_y = first.speed * first.sin * dt - second.speed * second.sin * dt
    apart_x = (a[0][0] + a[1][0] + a[2][0] + a[3][0]) / 4.0 - (b[0][0] + b[1][0] + b[2][0] + b[3][0]) / 4.0
    apart_y = (a[0][1] + a[1][1] + a[2][1] + a[3][1]) / 4.0 - (b[0][1] + b[1][1] + b[2][1] + b[3][1]) / 4.0
    now, soon, least, way_x, way_y = True, True, math.inf, 0.0, 0.0
    for side in range(8):
        points, k = (a, side) if side < 4 else (b, side - 4)
        start, end = points[k], points[(k + 1) % 4]
        nx, ny = start[1] - end[1], end[0] - start[0]
        norm = math.sqrt(nx * nx + ny * ny)
        nx, ny = nx / norm, ny / norm
        (low, high), (other_low, other_high) = shadow(a, nx, ny), shadow(b, nx, ny)
        if interval_distance(low, high, other_low, other_high) > 0.0:
            now = False
        move = nx * move_x + ny * move_y
        if move < 0.0:
            low += move
        else:
            high += move
        overlap = interval_distance(low, high, other_low, other_high)
        if overlap > 0.0:
            soon = False
        if not now and not soon:
            break
        if abs(overlap) < least:
            least = abs(overlap)
            sign = 1.0 if apart_x * nx + apart_y * ny > 0.0 else -1.0
            way_x, way_y = sign * nx, sign * ny
    return now, soon, least * way_x, least * way_y


@inlined
def row_of(k: int, before_ego: int) -> int:
    """The row of car number `k` in highway-env's order of vehicles, in which others come before the ego, row 0."""
    if k > before_ego:
        return k
    return k + 1 if k < before_ego else 0


@inlined
def count_near(x: Any, place: float, near: float) -> int:
    """How many of the numbers in `x` are within `near` of `place`; compiled, eight are compared at once."""
    count = 0
    for other in x:
        count += abs(other - place) <= near
    return count


@inlined
def collide(cars: Any, places: Any, rules: Any, before_ego: int) -> None:
    """Find who touches whom: marks wrecks, and how far those that will touch are pushed apart in the next step.

    Pairs are looked at in highway-env's order of vehicles, after which obstacles come; by ``rules.ego_contacts`` only
    those with a learning car.
    """
    n, x = len(cars), places.room[0]
    for i in range(n):
        x[i] = cars[row_of(i, before_ego)].x
    for i in range(n):
        a, j = cars[row_of(i, before_ego)], i
        near = DIAGONAL + a.speed * rules.dt  # the speed of the first alone counts, as in highway-env
        left = count_near(x[i + 1 :], a.x, near)
        while left > 0:
            j += 1
            if abs(x[j] - a.x) > near:
                continue
            left -= 1
            b = cars[row_of(j, before_ego)]
            if rules.ego_contacts and not (a.is_ego or b.is_ego):
                continue
            dx, dy = b.x - a.x, b.y - a.y
            reach = (DIAGONAL + OBSTACLE_DIAGONAL) / 2 + a.speed * rules.dt if b.is_obstacle else near
            if a.is_obstacle or math.sqrt(dx * dx + dy * dy) > reach:
                continue
            now, soon, way_x, way_y = touch(a, b, rules.dt)
            if soon and b.is_obstacle:
                a.is_pushed_apart, a.apart_x, a.apart_y = True, way_x, way_y
            elif soon:
                a.is_pushed_apart = b.is_pushed_apart = True
                a.apart_x, a.apart_y = way_x / 2.0, way_y / 2.0
                b.apart_x, b.apart_y = -way_x / 2.0, -way_y / 2.0
            if now:
                a.crashed = b.crashed = True


@inlined
def ego_ttc(cars: Any) -> float:
    """``measures.ego_ttc`` of the ego, the first car, with those within TTC_RADIUS [s]."""
    ego, least = cars[0], math.inf
    state = (ego.x, ego.y, ego.speed, ego.heading)
    for j in range(1, len(cars)):
        car = cars[j]
        if abs(car.x - ego.x) <= TTC_RADIUS and math.hypot(car.x - ego.x, car.y - ego.y) <= TTC_RADIUS:
            other = (car.x, car.y, car.speed, car.heading)
            least = min(least, _ego_ttc(state, (other,), min(least, HORIZON)))
    return least
