"""What has to be known after every sub-step: whether anybody touched, and how close the ego came to it."""

from __future__ import annotations

from sumo_env.cars import BEFORE, CRASHED, HEADING, SPEED, Flags, X, Y
from sumo_env.collision import meetings
from sumo_env.compiled import compiled
from sumo_env.safety import ego_ttc
from sumo_env.scene import Floats


@compiled
def dangers(floats: Floats, flags: Flags, horizon: float) -> tuple[int, float]:
    """Number of pairs that `meetings` finds in the last sub-step, and `ego_ttc` [s] at its end.

    floats, flags: of `cars.Cars`; horizon: [s].
    """
    x, y, heading = floats[X], floats[Y], floats[HEADING]
    pairs, _ = meetings(floats[BEFORE : BEFORE + 3], x, y, heading, ~flags[CRASHED])
    return len(pairs), ego_ttc(x, y, floats[SPEED], heading, horizon)
