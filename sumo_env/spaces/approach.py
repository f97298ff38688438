"""Features of a Kinematics table that say how near a vehicle is to the ego, and how near it will come.

They are computed from the places and velocities in the table's rows alone, and are the same whether the table is
absolute or not. One function serves all simulators: the kernels of the replica compile it, and the experiments apply it
to the tables of highway-env.
"""

import math

from sumo_env.scene import MAX_SPEED

# Place [m] and velocity [m/s] relative to the ego, along the axes of the table; the distance of the centres [m]; the
# time to the closest point of approach [s], and the distance there [m], if both keep their velocities.
APPROACH = ("dx", "dy", "dvx", "dvy", "distance", "tcpa", "dcpa")
HORIZON = 6.0  # [s] looked ahead
STILL = 0.5  # [m/s] relative speeds far below count as none: without it the time of a follower would jump
# Where a configuration gives none. Places are not clipped nearer than the roads of a crossing reach.
RANGES = {
    "dx": (-100.0, 100.0),
    "dy": (-100.0, 100.0),
    "dvx": (-2.0 * MAX_SPEED, 2.0 * MAX_SPEED),
    "dvy": (-2.0 * MAX_SPEED, 2.0 * MAX_SPEED),
    "distance": (0.0, 50.0),
    "tcpa": (0.0, HORIZON),
    "dcpa": (0.0, 25.0),
}


def approach(dx: float, dy: float, dvx: float, dvy: float) -> tuple[float, ...]:
    """The features `APPROACH` of a vehicle at (dx, dy) [m] from the ego with (dvx, dvy) [m/s] more velocity.

    The time is 0 for vehicles that do not come closer, and `HORIZON` at most; the distance is that at this time.
    """
    time = -(dx * dvx + dy * dvy) / (dvx * dvx + dvy * dvy + STILL * STILL)
    time = min(max(time, 0.0), HORIZON)
    return dx, dy, dvx, dvy, math.hypot(dx, dy), time, math.hypot(dx + time * dvx, dy + time * dvy)
