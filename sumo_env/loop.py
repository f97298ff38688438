"""The sub-steps of a policy step in one compiled call, for as long as Python has nothing to decide.

What `world.World.step` does one sub-step after another, and the same bits: drivers decide, cars move, SUMO is told and
steps, contacts are looked for. Cars are steered (`straight`, `bends`) or keep to SUMO's lanes (`strip`, `native`). A
call stops early where Python goes on: somebody touched, the ego is about to reach the end of its lane (not in `bends`),
a vehicle has left the road, or SUMO raised an error. SUMO's step, its list of contacts, changes of lane and the ego's
next lane are called as Python functions, which may raise.
"""

from __future__ import annotations

from typing import NamedTuple

from sumo_env import direct
from sumo_env.cars import (
    ACCELERATION,
    BEFORE,
    COMMAND,
    CRASHED,
    DISTANCE,
    FRONT_X,
    FRONT_Y,
    HEADING,
    LANE,
    LATERAL,
    MODE,
    MOVED,
    OWN_SPEED,
    SPEED,
    TARGET,
    Flags,
    X,
    Y,
)
from sumo_env.collision import NEAR
from sumo_env.compiled import borrowing
from sumo_env.ego import TAU, approach, coast
from sumo_env.models import mobil, network_drivers
from sumo_env.models.dangers import anybody_near, dangers, may_touch
from sumo_env.models.give_way import give_way
from sumo_env.models.hazards import push, push_native
from sumo_env.models.idm import act_on_strip
from sumo_env.models.lane_net import Net
from sumo_env.models.lane_table import Floats, Integers
from sumo_env.models.motion import euler, keep_to_lanes
from sumo_env.models.steering import is_near_end, move
from sumo_env.safety import HORIZON

GOES_ON, TOUCHED, NEAR_END, LOST = range(4)  # why a call ended
STEP, CONTACTS, CHANGE_LANES, FOLLOW_ROAD = range(4)  # Python functions that it calls


class Traffic(NamedTuple):
    """What stays the same while the same vehicles drive.

    Attributes:
        delta: length of a step [ms].
        functions, vehicles, names, known_lanes, lane_order: as in `direct`.
        calls: of `direct.python_calls`: SUMO's step, whether it reports contacts, changes of lane, and the ego's next
            lane.
        geometry, lanes, joints, stretch: as in `models.steering.move`; for cars on SUMO's lanes three rows of `lanes`,
            no `joints`, and `stretch` as in `models.motion.keep_to_lanes`.
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

    roads: Net
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


@borrowing
def _ego(speed: float, crashed: bool, target_speed: float, dt: float) -> tuple[float, float]:
    """As `ego.Ego.advance`: its speed [m/s] after the sub-step, and how far it drives [m]."""
    return coast(speed, dt) if crashed else approach(speed, target_speed, TAU, dt)


@borrowing
def _steered(traffic: Traffic, progress: Progress, ego_speed: float, dt: float) -> Progress:
    """A sub-step of steered cars, from their accelerations on."""
    floats, integers, flags = traffic.floats, traffic.integers, traffic.flags
    floats[SPEED, 0], floats[DISTANCE, 0] = _ego(floats[SPEED, 0], flags[CRASHED, 0], ego_speed, dt)
    changes, near_end = move(
        traffic.geometry, traffic.lanes, traffic.joints, traffic.stretch, floats, integers, flags, dt
    )
    near = anybody_near(floats[X], floats[Y], floats[HEADING], NEAR)
    known = not changes or direct.call(traffic.calls, CHANGE_LANES) >= 0
    if known:
        direct.command(
            traffic.functions, traffic.vehicles, traffic.names, floats[COMMAND], floats[LATERAL], flags[MOVED],
            traffic.delta,
        )  # fmt: skip
        direct.look_for_collisions(traffic.functions, near)  # 7 % of SUMO's step on the highway
        known = direct.call(traffic.calls, STEP) >= 0 and direct.read_fronts(
            traffic.functions, traffic.vehicles, traffic.known_lanes, traffic.lane_order, True,
            floats[FRONT_X : FRONT_Y + 1], integers[LANE],
        )  # fmt: skip
        direct.look_for_collisions(traffic.functions, True)
    return _judged(progress, known, near, near_end, floats, flags, traffic.calls, dt)


@borrowing
def _on_lanes(traffic: Traffic, progress: Progress, ego_speed: float, ego_place: int, dt: float) -> Progress:
    """A sub-step of cars that keep to SUMO's lanes, from the ways of those who are told them on."""
    floats, integers, flags = traffic.floats, traffic.integers, traffic.flags
    floats[OWN_SPEED, 0], floats[DISTANCE, 0] = _ego(floats[SPEED, 0], flags[CRASHED, 0], ego_speed, dt)
    keep_to_lanes(floats, integers, flags, traffic.stretch, dt)
    direct.set_speeds(traffic.functions, traffic.vehicles, floats[COMMAND], traffic.delta)
    _, place, count = traffic.lanes[:, integers[LANE, 0]]
    changes = count > 0 and place != ego_place and not flags[CRASHED, 0]
    near = may_touch(floats, flags, dt)
    direct.look_for_collisions(traffic.functions, near)  # a fifth of SUMO's step on the highway
    known = (
        (not changes or direct.call(traffic.calls, CHANGE_LANES) >= 0)
        and direct.call(traffic.calls, STEP) >= 0
        and direct.read(
            traffic.functions, traffic.vehicles, traffic.known_lanes, traffic.lane_order, True,
            floats[OWN_SPEED], floats[: SPEED + 1], floats[BEFORE : BEFORE + 3], integers[LANE],
        )
    )  # fmt: skip
    direct.look_for_collisions(traffic.functions, True)
    near_end = is_near_end(traffic.geometry, integers[TARGET, 0], floats[X, 0], floats[Y, 0])
    return _judged(progress, known, near, near_end, floats, flags, traffic.calls, dt)


@borrowing
def _judged(
    progress: Progress, known: bool, looked: bool, near_end: bool, floats: Floats, flags: Flags, calls: Integers,
    dt: float,
) -> Progress:  # fmt: skip
    """The progress with one more sub-step, after which it is `known` where everybody is, or an error was raised.

    looked: whether SUMO did, for contacts.
    """
    why, touching, ttc, least = LOST, 0, 0.0, progress.least_ttc
    if known:
        touching, ttc = dangers(floats, flags, HORIZON)
        if touching > 0 or (looked and direct.call(calls, CONTACTS) != 0):
            why = TOUCHED
        else:
            why = NEAR_END if near_end else GOES_ON
            if not flags[CRASHED, 0]:
                least = min(least, ttc)
    distance = progress.distance + floats[DISTANCE, 0]
    return Progress(progress.done + 1, why, touching, ttc, progress.time + dt, distance, least)


@borrowing
def straight(
    traffic: Traffic, count: int, lanes_count: int, lane_width: float, length: float, limit: float, progress: Progress,
    ego_speed: float, dt: float,
) -> Progress:  # fmt: skip
    """Up to `count` sub-steps on the highway (`models.mobil`), going on from `progress`."""
    while progress.done < count and progress.why == GOES_ON:
        mobil.act(
            traffic.floats, traffic.integers, traffic.flags, traffic.drivers, lanes_count, lane_width, length, limit,
            dt,
        )  # fmt: skip
        push(traffic.floats, traffic.flags, progress.time, dt)
        progress = _steered(traffic, progress, ego_speed, dt)
    return progress


@borrowing
def bends(traffic: Traffic, count: int, ways: Ways, progress: Progress, ego_speed: float, dt: float) -> Progress:
    """Up to `count` sub-steps on a road of bends (`models.network_drivers`), going on from `progress`.

    Lanes are short there: the ego is given the next one in between.
    """
    while progress.done < count and progress.why in (GOES_ON, NEAR_END):
        if progress.why == NEAR_END and direct.call(traffic.calls, FOLLOW_ROAD) < 0:
            break
        if len(ways.routes) > 0:
            give_way(
                traffic.geometry, ways.routes, ways.stage, ways.exempt, ways.clock, traffic.floats, traffic.flags, dt
            )
        network_drivers.act(
            ways.roads, ways.ways, traffic.floats, traffic.integers, traffic.flags, traffic.drivers,
            progress.time > 0.0, dt,
        )  # fmt: skip
        push(traffic.floats, traffic.flags, progress.time, dt)
        progress = _steered(traffic, progress, ego_speed, dt)
    return progress


@borrowing
def strip(
    traffic: Traffic, count: int, sides: Floats, length: float, limit: float, progress: Progress, ego_speed: float,
    ego_place: int, dt: float,
) -> Progress:  # fmt: skip
    """Up to `count` sub-steps on the two-way road (`models.idm.act_on_strip`), going on from `progress`."""
    while progress.done < count and progress.why == GOES_ON:
        act_on_strip(traffic.floats, sides, traffic.drivers, length, limit)
        push(traffic.floats, traffic.flags, progress.time, dt)
        euler(
            traffic.floats[SPEED], traffic.floats[ACCELERATION], traffic.flags[CRASHED], dt, 0.0,
            traffic.floats[OWN_SPEED], traffic.floats[DISTANCE],
        )  # fmt: skip
        progress = _on_lanes(traffic, progress, ego_speed, ego_place, dt)
    return progress


@borrowing
def native(
    traffic: Traffic, count: int, modes: tuple[int, int, int], progress: Progress, ego_speed: float, ego_place: int,
    dt: float,
) -> Progress:  # fmt: skip
    """Up to `count` sub-steps of traffic that SUMO drives (`models.hazards.push_native`), going on from `progress`."""
    while progress.done < count and progress.why == GOES_ON:
        push_native(traffic.floats, traffic.integers, traffic.flags, modes, progress.time, dt)
        direct.set_speed_modes(traffic.functions, traffic.vehicles, traffic.integers[MODE])
        progress = _on_lanes(traffic, progress, ego_speed, ego_place, dt)
    return progress
