"""The sub-steps of steered traffic in one compiled call, for as long as Python has nothing to decide.

What `world.World.step` does one sub-step after another, and the same bits: drivers decide, cars move, SUMO is told and
steps, contacts are looked for. It stops early where Python goes on: somebody touched, the ego is about to reach the end
of its lane, a vehicle has left the road, or SUMO raised an error. SUMO's step and its list of contacts are called as
Python functions, which may raise.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sumo_env import direct
from sumo_env.cars import (
    COMMAND,
    CRASHED,
    DISTANCE,
    FRONT_X,
    FRONT_Y,
    HEADING,
    LANE,
    LATERAL,
    MOVED,
    SPEED,
    Flags,
    X,
    Y,
)
from sumo_env.collision import NEAR
from sumo_env.compiled import compiled
from sumo_env.ego import TAU, approach, coast
from sumo_env.models import mobil, network_drivers
from sumo_env.models.dangers import anybody_near, dangers
from sumo_env.models.give_way import give_way
from sumo_env.models.hazards import push
from sumo_env.models.lane_table import Floats, Integers
from sumo_env.models.steering import move
from sumo_env.safety import HORIZON

GOES_ON, TOUCHED, NEAR_END, LOST = range(4)  # why a call ended
STEP, CONTACTS, CHANGE_LANES = range(3)  # Python functions that it calls


class Traffic(NamedTuple):
    """What stays the same while the same vehicles drive.

    Attributes:
        delta: length of a step [ms].
        functions, vehicles, names, known_lanes, lane_order: as in `direct`.
        calls: of `direct.python_calls`: SUMO's step, whether it reports contacts, and changes of lane.
        geometry, lanes, joints, stretch: as in `models.steering.move`.
        floats, integers, flags: of `cars.Cars`.
        drivers: shape (n, 6).
    """

    delta: int
    functions: Integers
    vehicles: Integers
    names: Integers
    known_lanes: Integers
    lane_order: Integers
    calls: Integers
    geometry: Floats
    lanes: Integers
    joints: Floats
    stretch: Floats
    floats: Floats
    integers: Integers
    flags: Flags
    drivers: Floats


class Ways(NamedTuple):
    """What drivers on a road of bends know besides.

    Attributes:
        roads, ways: as in `models.network_drivers.drive`.
        routes, stage, exempt, clock: as in `models.give_way.give_way`; no rows of `routes` where nobody gives way.
    """

    roads: network_drivers.Net
    ways: Integers
    routes: Integers
    stage: Integers
    exempt: Flags
    clock: Floats


class Progress(NamedTuple):
    """How far a call came.

    Attributes:
        done: sub-steps.
        why: it ended, one of the constants above.
        touching, ttc: of `dangers`, after the last sub-step; that one's `ttc` is not yet in `least_ttc` if it TOUCHED.
        time, distance, least_ttc: of the world [s, m, s].
    """

    done: int
    why: int
    touching: int
    ttc: float
    time: float
    distance: float
    least_ttc: float


@compiled
def _substep(traffic: Traffic, ego_target: float, dt: float) -> tuple[int, int, float, float]:
    """From the accelerations on: why to stop, pairs touching, time to collision [s], and the ego's way [m]."""
    floats, integers, flags = traffic.floats, traffic.integers, traffic.flags
    speed = floats[SPEED]
    if flags[CRASHED, 0]:
        speed[0], moved = coast(speed[0], dt)
    else:
        speed[0], moved = approach(speed[0], ego_target, TAU, dt)
    floats[DISTANCE, 0] = moved
    changes, near_end = move(
        traffic.geometry, traffic.lanes, traffic.joints, traffic.stretch, floats, integers, flags, dt
    )
    if changes and direct.call(traffic.calls, CHANGE_LANES) < 0:
        return LOST, 0, 0.0, moved
    direct.command(
        traffic.functions, traffic.vehicles, traffic.names, floats[COMMAND], floats[LATERAL], flags[MOVED],
        traffic.delta,
    )  # fmt: skip
    near = anybody_near(floats[X], floats[Y], floats[HEADING], NEAR)
    direct.look_for_collisions(traffic.functions, near)  # a tenth of SUMO's step
    stepped = direct.call(traffic.calls, STEP)
    direct.look_for_collisions(traffic.functions, True)
    if stepped < 0:
        return LOST, 0, 0.0, moved
    if not direct.read_fronts(
        traffic.functions, traffic.vehicles, traffic.known_lanes, traffic.lane_order, True,
        floats[FRONT_X : FRONT_Y + 1], integers[LANE],
    ):  # fmt: skip
        return LOST, 0, 0.0, moved
    touching, ttc = dangers(floats, flags, HORIZON)
    if touching > 0 or (near and direct.call(traffic.calls, CONTACTS) != 0):
        return TOUCHED, touching, ttc, moved
    return NEAR_END if near_end else GOES_ON, 0, ttc, moved


@compiled
def straight(
    traffic: Traffic, count: int, lanes_count: int, lane_width: float, length: float, limit: float, progress: Progress,
    ego_target: float, dt: float,
) -> Progress:  # fmt: skip
    """Up to `count` sub-steps on the highway (`models.mobil`), going on from `progress`."""
    _, _, _, _, time, distance, least = progress
    done, why, touching, ttc = 0, GOES_ON, 0, np.inf
    while done < count and why == GOES_ON:
        mobil.act(
            traffic.floats, traffic.integers, traffic.flags, traffic.drivers, lanes_count, lane_width, length, limit,
            dt,
        )  # fmt: skip
        push(traffic.floats, traffic.flags, time, dt)
        why, touching, ttc, moved = _substep(traffic, ego_target, dt)
        done, time, distance = done + 1, time + dt, distance + moved
        if why in (GOES_ON, NEAR_END) and not traffic.flags[CRASHED, 0]:
            least = min(least, ttc)
    return Progress(done, why, touching, ttc, time, distance, least)


@compiled
def bends(traffic: Traffic, count: int, ways: Ways, progress: Progress, ego_target: float, dt: float) -> Progress:
    """Up to `count` sub-steps on a road of bends (`models.network_drivers`), going on from `progress`."""
    _, _, _, _, time, distance, least = progress
    done, why, touching, ttc = 0, GOES_ON, 0, np.inf
    while done < count and why == GOES_ON:
        if len(ways.routes) > 0:
            give_way(
                traffic.geometry, ways.routes, ways.stage, ways.exempt, ways.clock, traffic.floats, traffic.flags, dt
            )
        network_drivers.act(
            ways.roads, ways.ways, traffic.floats, traffic.integers, traffic.flags, traffic.drivers, time > 0.0, dt
        )
        push(traffic.floats, traffic.flags, time, dt)
        why, touching, ttc, moved = _substep(traffic, ego_target, dt)
        done, time, distance = done + 1, time + dt, distance + moved
        if why in (GOES_ON, NEAR_END) and not traffic.flags[CRASHED, 0]:
            least = min(least, ttc)
    return Progress(done, why, touching, ttc, time, distance, least)
