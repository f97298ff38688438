"""From accelerations to ways: highway-env's Euler steps at any length of step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sumo_env.compiled import compiled
from sumo_env.ego import REFERENCE_STEP
from sumo_env.models.lane_table import Floats


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
    wrecks. speed, acceleration, crashed, own_speed, distance: shape (n,); `own_speed` may be `speed` itself.
    """
    lead = (dt - REFERENCE_STEP) / 2.0
    for i in range(1, len(speed)):
        if not crashed[i]:
            distance[i] = max(speed[i] + acceleration[i] * lead, least) * dt
            own_speed[i] = max(speed[i] + acceleration[i] * dt, least)
