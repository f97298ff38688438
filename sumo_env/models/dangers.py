"""What has to be known after every sub-step: whether anybody touched, and how close the ego came to it."""

from __future__ import annotations

import math

from sumo_env.cars import BEFORE, CRASHED, HEADING, SPEED, Flags, X, Y
from sumo_env.collision import DIAGONAL, LENGTH, NEAR, WIDTH, meetings, separation
from sumo_env.compiled import borrowing, compiled
from sumo_env.safety import ego_ttc
from sumo_env.scene import Floats

# Braking, surging and changing lane bring SUMO's cars less than 0.9 m nearer to each other in a tenth of a second than
# driving straight on does. Side by side in neighbouring lanes they are 2 m apart.
SOON = NEAR + 0.9  # [m]
LONGEST_STEP = 0.1 + 1e-9  # [s]


@compiled
def dangers(floats: Floats, flags: Flags, horizon: float) -> tuple[int, float]:
    """Number of pairs that `meetings` finds in the last sub-step, and `ego_ttc` [s] at its end.

    floats, flags: of `cars.Cars`; horizon: [s].
    """
    x, y, heading = floats[X], floats[Y], floats[HEADING]
    pairs, _ = meetings(floats[BEFORE : BEFORE + 3], x, y, heading, ~flags[CRASHED])
    return len(pairs), ego_ttc(x, y, floats[SPEED], heading, horizon)


@borrowing
def anybody_near(x: Floats, y: Floats, heading: Floats, margin: float) -> bool:
    """Whether the outlines of two vehicles may be `margin` [m] apart or less; x, y [m], heading [rad], shape (n,)."""
    reach = DIAGONAL + margin
    for i in range(len(x)):
        for j in range(i + 1, len(x)):
            dx, dy = x[j] - x[i], y[j] - y[i]
            if (
                abs(dx) <= reach
                and dx * dx + dy * dy <= reach * reach
                and separation(x[i], y[i], heading[i], x[j], y[j], heading[j], LENGTH, WIDTH) <= margin
            ):
                return True
    return False


@compiled
def may_touch(floats: Floats, flags: Flags, dt: float) -> bool:
    """Whether a report of SUMO may count after its next step of `dt` [s], which it moves the cars in.

    That is one of cars within `collision.NEAR`, or of the crash. floats, flags: of `cars.Cars`.
    """
    if flags[CRASHED, 0] or dt > LONGEST_STEP:
        return True
    x, y, heading = floats[X].copy(), floats[Y].copy(), floats[HEADING]
    for i in range(len(x)):
        x[i] += floats[SPEED, i] * dt * math.cos(heading[i])
        y[i] += floats[SPEED, i] * dt * math.sin(heading[i])
    return anybody_near(x, y, heading, SOON)
