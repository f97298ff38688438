"""Vehicles as oriented rectangles: whether, when and how deep two of them touch.

Two convex shapes are apart if, and only if, a line separates them, and for rectangles it is enough to try the
directions of their four sides (separating axis theorem; figure 4 of the paper). A test every 0.1 s would miss a
corner that is grazed in between, so contacts are looked for all along the way of a sub-step (`touch_moment`,
`first_touch`). Figures: docs/collisions.md.

All functions take plain floats: with the handful of vehicles near the ego this is faster than numpy. A vehicle is a
`State`, and has highway-env's size where no other is given. `sumo_env.replica.compiled` compiles some of them as well.
"""

from collections.abc import Sequence
from math import cos, hypot, inf, sin, sqrt

from sumo_env.networks.lanes import wrap_to_pi
from sumo_env.scene import VEHICLE_LENGTH, VEHICLE_WIDTH, Scene

State = tuple[float, float, float, float]  # x, y [m], speed [m/s], heading [rad], as in a `Scene`

LENGTH: float = VEHICLE_LENGTH
WIDTH: float = VEHICLE_WIDTH
HALF_LENGTH, HALF_WIDTH = LENGTH / 2.0, WIDTH / 2.0
Half = tuple[float, float]  # half the length and half the width of a vehicle [m]
CAR: Half = (HALF_LENGTH, HALF_WIDTH)
DIAGONAL = hypot(LENGTH, WIDTH)  # [m] cars whose centres are further apart are not in contact
# [m] Smaller gaps count as contact, so that a check at the exact moment of touching finds it.
ROUNDING = 1e-9
FINEST = 0.01  # of a sub-step: a contact that is shorter (1 ms of 0.1 s) may be missed


def state_of(scene: Scene, row: int) -> State:
    """The state of one vehicle of a scene."""
    return scene.x.item(row), scene.y.item(row), scene.speed.item(row), scene.heading.item(row)


def states(scene: Scene) -> list[State]:
    """The states of all vehicles of a scene, the ego's first."""
    return list(
        zip(scene.x.tolist(), scene.y.tolist(), scene.speed.tolist(), scene.heading.tolist(), strict=True)
    )


def state_between(before: State, after: State, moment: float) -> State:
    """The state at a moment of a sub-step, 0 (its start) to 1: the pose in between, the speed of its end."""
    x, y, _, heading = before
    return (
        x + moment * (after[0] - x),
        y + moment * (after[1] - y),
        after[2],
        heading + moment * wrap_to_pi(after[3] - heading),
    )


def reach_of(half: Half, own: Half = CAR) -> float:
    """Between the centres of two vehicles of these half sizes [m]: further apart they are not in contact."""
    return hypot(own[0], own[1]) + hypot(half[0], half[1])


def separation(first: State, second: State, half: Half = CAR, other: Half = CAR) -> float:
    """Largest gap [m] between two vehicles over the directions of their sides, positive if they are apart.

    Apart, it is a lower bound of their distance; in contact, minus the depth of penetration, that is, the least
    distance by which one has to be moved to free it.
    """
    dx, dy = second[0] - first[0], second[1] - first[1]
    c1, s1, c2, s2 = cos(first[3]), sin(first[3]), cos(second[3]), sin(second[3])
    parallel, across = abs(c1 * c2 + s1 * s2), abs(c1 * s2 - s1 * c2)
    # Half the extent of both together along the length of either and across it.
    length, width = extents(half, other, parallel, across)
    other_length, other_width = (length, width) if half == other else extents(other, half, parallel, across)
    return max(
        abs(dx * c1 + dy * s1) - length,
        abs(dy * c1 - dx * s1) - width,
        abs(dx * c2 + dy * s2) - other_length,
        abs(dy * c2 - dx * s2) - other_width,
    )


def extents(half: Half, other: Half, parallel: float, across: float) -> tuple[float, float]:
    """Half the extent [m] of two vehicles together, along the length of the first and across it.

    parallel, across: cosine and sine of the angle between them, without sign.
    """
    length = half[0] + other[0] * parallel + other[1] * across
    width = half[1] + other[0] * across + other[1] * parallel
    return length, width


def distance(first: State, second: State, half: Half = CAR, other: Half = CAR) -> float:
    """Distance [m] of the outlines of two vehicles; in contact, minus the depth of penetration."""
    gap = separation(first, second, half, other)
    if gap <= 0.0:
        return gap
    # Apart, a corner of one of the two is the point that is nearest to the other.
    return min(corner_distance(first, second, half, other), corner_distance(second, first, other, half))


def corner_distance(first: State, second: State, half: Half, other: Half) -> float:
    """Distance [m] from the first rectangle to the nearest corner of the second."""
    dx, dy, turn = second[0] - first[0], second[1] - first[1], second[3] - first[3]
    c, s = cos(first[3]), sin(first[3])
    x, y = dx * c + dy * s, dy * c - dx * s
    c, s = cos(turn), sin(turn)
    nearest = inf
    for along in (-other[0], other[0]):
        for across in (-other[1], other[1]):
            beyond_end = max(abs(x + along * c - across * s) - half[0], 0.0)
            beyond_side = max(abs(y + along * s + across * c) - half[1], 0.0)
            nearest = min(nearest, hypot(beyond_end, beyond_side))
    return nearest


def stay_apart(x: float, y: float, x_after: float, y_after: float, reach: float) -> bool:
    """Whether a way from centre to centre [m] is longer than `reach` along x or along y all through a sub-step.

    It changes evenly from (x, y) to (x_after, y_after). The quickest test, which rules out most vehicles.
    """
    return (
        (x > reach and x_after > reach)
        or (x < -reach and x_after < -reach)
        or (y > reach and y_after > reach)
        or (y < -reach and y_after < -reach)
    )


def touch_moment(
    first: State,
    first_after: State,
    second: State,
    second_after: State,
    other: Half = CAR,
    own: Half = CAR,
) -> float:
    """When two vehicles first touch within a sub-step, 0 (its start) to 1; inf if not.

    `own` and `other` are the half sizes of the first and the second.

    Both move evenly from their pose before to the one after and turn the short way. Where they are apart by a gap,
    they cannot meet before the fastest of their points have come that far: the next look is there (conservative
    advancement), or `FINEST` later, whichever is more.
    """
    cars = own == CAR and other == CAR
    reach = DIAGONAL if cars else reach_of(other, own)
    # the way from the first centre to the second, and how it changes during the sub-step
    rx, ry = second[0] - first[0], second[1] - first[1]
    sx, sy = second_after[0] - first_after[0], second_after[1] - first_after[1]
    if stay_apart(rx, ry, sx, sy, reach):
        return inf
    ux, uy = sx - rx, sy - ry
    squared = ux * ux + uy * uy
    nearest = min(max(-(rx * ux + ry * uy) / squared, 0.0), 1.0) if squared else 0.0
    x, y = rx + nearest * ux, ry + nearest * uy
    if x * x + y * y > reach * reach:
        return inf  # not even their circumscribed circles meet
    h1, h2 = first[3], second[3]
    turn1, turn2 = wrap_to_pi(first_after[3] - h1), wrap_to_pi(second_after[3] - h2)
    fastest = sqrt(squared) + reach / 2.0 * (abs(turn1) + abs(turn2))
    if not cars:
        fastest = sqrt(squared) + hypot(*own) * abs(turn1) + hypot(*other) * abs(turn2)
    moment = 0.0
    while True:
        now = rx + moment * ux, ry + moment * uy, 0.0, h2 + moment * turn2  # as seen from the first
        gap = separation((0.0, 0.0, 0.0, h1 + moment * turn1), now, own, other)
        if gap <= ROUNDING:
            return moment
        if moment == 1.0 or gap > fastest * (1.0 - moment):
            return inf
        moment = min(moment + max(gap / fastest, FINEST), 1.0)


def first_touch(
    ego: State,
    ego_after: State,
    others: Sequence[State],
    others_after: Sequence[State],
    halves: Sequence[Half],
    own: Half,
) -> tuple[int, float] | None:
    """Which of the others the ego touches first within a sub-step, as (row, moment), and None if none; `touch_moment`.

    The rows of `others` (before the sub-step), `others_after` and `halves` (half sizes) are the same vehicles. `own` is
    the ego's half size.
    """
    least, row = inf, -1
    for k, (other, other_after, half) in enumerate(zip(others, others_after, halves, strict=True)):
        moment = touch_moment(ego, ego_after, other, other_after, half, own)
        if moment < least:
            least, row = moment, k
    return None if row < 0 else (row, least)
