"""What even a risky driver looks at: whether there is room to cut in, and whether the way straight ahead is free.

Both are asked when a risk event (`drivers.RiskEvent`) would begin or go on, of all vehicles alike, the ego included.
Without them most events would be crashes among the traffic itself, far from the ego (docs/decisions.md, "Risk").
"""

from __future__ import annotations

import math

from sumo_env.cars import (
    ACCELERATION,
    COMMAND,
    CRASHED,
    HEADING,
    MODE,
    PUSH,
    PUSH_END,
    PUSH_WAY,
    SPEED,
    Flags,
    X,
    Y,
)
from sumo_env.collision import LENGTH, WIDTH, distance
from sumo_env.compiled import borrowing
from sumo_env.models.lane_table import Integers
from sumo_env.scene import Floats

CUT_IN_GAP = 1.0  # [m] to everybody in the lane beside; who is nearer is waited out, that is, the event is dropped
EARLY = 1e-9  # [s] rounding of the time
HALF_CORRIDOR = 2.0  # [m] to either side of the centre: half a lane


@borrowing
def has_room(
    x: Floats, y: Floats, heading: Floats, row: int, there_x: float, there_y: float, there_heading: float
) -> bool:
    """Would vehicle `row`, moved to the place beside, be at least CUT_IN_GAP from every other vehicle?

    x, y [m], heading [rad]: shape (n,). The place: centre [m] and heading [rad] in the middle of the other lane.
    """
    for j in range(len(x)):
        if j == row or abs(x[j] - there_x) + abs(y[j] - there_y) > 4.0 * LENGTH:
            continue
        gap = distance(there_x, there_y, there_heading, x[j], y[j], heading[j], LENGTH, WIDTH)
        if gap < CUT_IN_GAP:
            return False
    return True


@borrowing
def push(floats: Floats, flags: Flags, time: float, dt: float) -> None:
    """Brake and surge as risk events ask, on top of what drivers want: changes ACCELERATION and PUSH in place.

    floats, flags: of `cars.Cars`; time, dt: [s].
    """
    acceleration, pushes, speed = floats[ACCELERATION], floats[PUSH], floats[SPEED]
    for i in range(len(pushes)):
        if pushes[i] == 0.0:
            continue
        if flags[CRASHED, i] or time >= floats[PUSH_END, i] - EARLY:
            pushes[i] = 0.0
        elif pushes[i] < 0.0:
            standstill = -max(speed[i], 0.0) / dt  # nobody brakes into reverse
            acceleration[i] = min(acceleration[i], max(pushes[i], standstill))
        elif free_way(floats[X], floats[Y], floats[HEADING], i, floats[PUSH_WAY, i]):
            acceleration[i] = max(acceleration[i], pushes[i])


@borrowing
def push_native(
    floats: Floats, integers: Integers, flags: Flags, modes: tuple[int, int, int], time: float, dt: float
) -> None:
    """As `push`, of cars that SUMO drives: writes COMMAND and MODE of all, which say nothing to those not pushed.

    floats, integers, flags: of `cars.Cars`; modes: of driving by oneself, braking and surging; time, dt: [s].
    """
    pushes, speed = floats[PUSH], floats[SPEED]
    itself, brakes, surges = modes
    for i in range(len(pushes)):
        pushed = pushes[i]
        floats[COMMAND, i], integers[MODE, i] = math.nan, -1
        ended = time >= floats[PUSH_END, i] - EARLY
        if ended or flags[CRASHED, i]:
            pushes[i] = 0.0
        if pushed == 0.0 or flags[CRASHED, i]:
            continue
        if ended or (
            pushed > 0.0 and not free_way(floats[X], floats[Y], floats[HEADING], i, floats[PUSH_WAY, i])
        ):
            floats[COMMAND, i], integers[MODE, i] = -1.0, itself
        else:
            floats[COMMAND, i] = max(speed[i] + pushed * dt, 0.0)
            integers[MODE, i] = brakes if pushed < 0.0 else surges


@borrowing
def free_way(x: Floats, y: Floats, heading: Floats, row: int, way: float) -> bool:
    """Is no centre of another vehicle in the straight corridor ahead of vehicle `row`?

    x, y [m], heading [rad]: shape (n,). way: length of the corridor, from centre to centre [m].
    """
    cos, sin = math.cos(heading[row]), math.sin(heading[row])
    for j in range(len(x)):
        dx, dy = x[j] - x[row], y[j] - y[row]
        if 0.0 < dx * cos + dy * sin < way and abs(dy * cos - dx * sin) < HALF_CORRIDOR:
            return False
    return True
