"""From accelerations to the speeds that SUMO is told: highway-env's Euler steps at any length of step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sumo_env.compiled import compiled
from sumo_env.ego import REFERENCE_STEP
from sumo_env.models.lane_table import Floats, Integers


@compiled
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
    wrecks. speed, acceleration, crashed, own_speed, distance: shape (n,).
    """
    lead = (dt - REFERENCE_STEP) / 2.0
    for i in range(1, len(speed)):
        if not crashed[i]:
            own_speed[i] = max(speed[i] + acceleration[i] * dt, least)
            distance[i] = max(speed[i] + acceleration[i] * lead, least) * dt


@compiled
def command_euler(
    speed: Floats,
    acceleration: Floats,
    crashed: NDArray[np.bool_],
    dt: float,
    lane: Integers,
    stretch: Floats,
    uneven: bool,
    own_speed: Floats,
    command: Floats,
) -> None:
    """Speeds to command for the next `dt` [s] into `command`, speeds after it into `own_speed` [m/s], shape (n,).

    Constant acceleration over `dt` moves as far as Euler steps of REFERENCE_STEP do; SUMO knows one number for the
    distance and the speed, so it is told the former. NaN, and nothing to `own_speed`, for row 0 and wrecks.

    Args:
        speed, acceleration, crashed: shape (n,) [m/s, m/s2].
        lane: numbers of the lanes, shape (n,); stretch: of each lane, the factor for a commanded speed.
        uneven: whether `stretch` matters at all.
    """
    lead = (dt - REFERENCE_STEP) / 2.0
    command[0] = np.nan
    for i in range(1, len(speed)):
        command[i] = np.nan
        if crashed[i]:
            continue
        own_speed[i] = max(speed[i] + acceleration[i] * dt, 0.0)
        command[i] = max(speed[i] + acceleration[i] * lead, 0.0) * dt / dt
        if uneven:
            command[i] *= stretch[lane[i]]
