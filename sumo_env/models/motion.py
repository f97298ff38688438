"""From accelerations to ways: highway-env's Euler steps at any length of step."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sumo_env.cars import COMMAND, CRASHED, DISTANCE, LANE, OWN_SPEED, SPEED, Flags
from sumo_env.compiled import borrowing
from sumo_env.ego import REFERENCE_STEP, coast
from sumo_env.models.lane_table import Floats, Integers


@borrowing
def euler(
    speed: Floats,
    acceleration: Floats,
    crashed: NDArray[np.bool_],
    dt: float,
    least: float,
    own_speed: Floats,
    distance: Floats,
) -> None:
    """Ways in the next `dt` [s] into `distance` [m] and speeds after it, at least `least`, into `own_speed` [m/s].

    Constant acceleration over `dt` moves as far as Euler steps of REFERENCE_STEP do. Nothing is written for row 0 and
    wrecks. speed, acceleration, crashed, own_speed, distance: shape (n,); `own_speed` may be `speed` itself.
    """
    lead = (dt - REFERENCE_STEP) / 2.0
    for i in range(1, len(speed)):
        if not crashed[i]:
            distance[i] = max(speed[i] + acceleration[i] * lead, least) * dt
            own_speed[i] = max(speed[i] + acceleration[i] * dt, least)


@borrowing
def keep_to_lanes(floats: Floats, integers: Integers, flags: Flags, stretch: Floats, dt: float) -> None:
    """Wrecks' next ways and speeds, and the speeds to COMMAND to cars that are to cover DISTANCE on SUMO's lanes.

    Wrecks decelerate with a = -v and stay where they stop, as in highway-env. Nothing is written for those whose way is
    NaN: SUMO drives them.

    Args:
        floats, integers, flags: of `cars.Cars`.
        stretch: lanes of one edge share one length in SUMO, so that metres are not metres in bends: factors for the
            speed of the ego and those of the others, by SUMO's lanes, shape (2, lanes).
        dt: [s].
    """
    for i in range(floats.shape[1]):
        if i > 0 and flags[CRASHED, i]:
            floats[OWN_SPEED, i], floats[DISTANCE, i] = coast(floats[SPEED, i], dt)
        if not math.isnan(floats[DISTANCE, i]):
            speed = max(floats[DISTANCE, i] / dt, 0.0)
            floats[COMMAND, i] = speed * stretch[min(i, 1), integers[LANE, i]]
