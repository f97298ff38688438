"""The state of the vehicles of an episode: three matrices, one column a vehicle, column 0 the ego.

What is handed to compiled code costs by the array, so that it takes the matrices and not their rows. Everything is in
highway-env's coordinates, and is written in place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sumo_env.scene import Floats

Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]

# Rows of `Cars.floats`.
X, Y, HEADING, SPEED = range(4)  # as shown [m, m, rad, m/s]
BEFORE = 4  # and two more: x, y, heading before the last sub-step
OWN_SPEED = 7  # after the next sub-step, where SUMO does not know it, else NaN [m/s]
DISTANCE = 8  # to drive in the next sub-step [m]
ACCELERATION = 9  # wanted by the driver [m/s2]
TARGET_SPEED = 10  # [m/s]
TIMER = 11  # since the last decision on lane changes [s]
FRONT_X, FRONT_Y = 12, 13  # front bumper of SUMO's car [m]
LATERAL = 14  # of SUMO's car, to the left of the middle of its lane [m]
COMMAND = 15  # speed that SUMO is told [m/s], NaN for none, negative: drive by yourself
PUSH, PUSH_END, PUSH_WAY = 16, 17, 18  # by a risk event [m/s2], 0 without one; until [s]; free way asked for [m]
FLOATS = 19

# Rows of `Cars.integers`.
LANE = 0  # of SUMO, by its number in `Simulation.lane_ids`
ON, TARGET = 1, 2  # lanes of highway-env, by their numbers in a `LaneTable`: on it, steered for
LEG, PLANNED = 3, 4  # see `models.network_drivers.drive`
CHANGE = 5  # of SUMO's car: as in `models.steering.follow`
MODE = 6  # speed mode that SUMO is told, -1 for none
INTEGERS = 7

# Rows of `Cars.flags`.
CRASHED, YIELDING = 0, 1
CHANGES = 2  # decides on lane changes
FORCED = 3  # is on a lane change that a risk event began
MOVED = 4  # SUMO is to be told the place on the lane
FLAGS = 5


class Cars:
    """The matrices, and their rows under the names that Python code uses.

    Attributes:
        floats, integers, flags: shapes (FLOATS, n), (INTEGERS, n), (FLAGS, n).
        pose, before: x, y, heading, shape (3, n), now and before the last sub-step.
        front: shape (2, n).
        x, y, heading, speed, ...: rows, shape (n,).
    """

    def __init__(self, n: int) -> None:
        self.floats: Floats = np.zeros((FLOATS, n))
        self.integers: Integers = np.zeros((INTEGERS, n), np.int64)
        self.flags: Flags = np.zeros((FLAGS, n), np.bool_)
        self.pose, self.before = self.floats[:3], self.floats[BEFORE : BEFORE + 3]
        self.state, self.front = self.floats[:4], self.floats[FRONT_X : FRONT_Y + 1]
        self.x, self.y, self.heading, self.speed = self.state
        self.own_speed, self.distance = self.floats[OWN_SPEED], self.floats[DISTANCE]
        self.own_speed[:] = self.distance[:] = np.nan
        self.acceleration, self.target_speed = self.floats[ACCELERATION], self.floats[TARGET_SPEED]
        self.timer, self.lateral = self.floats[TIMER], self.floats[LATERAL]
        self.command = self.floats[COMMAND]
        self.push, self.push_end, self.push_way = self.floats[PUSH : PUSH_WAY + 1]
        self.lane, self.on, self.target = self.integers[LANE], self.integers[ON], self.integers[TARGET]
        self.leg, self.planned, self.change = self.integers[LEG], self.integers[PLANNED], self.integers[CHANGE]
        self.mode = self.integers[MODE]
        self.crashed, self.yielding = self.flags[CRASHED], self.flags[YIELDING]
        self.changes, self.forced, self.moved = self.flags[CHANGES], self.flags[FORCED], self.flags[MOVED]

    def __len__(self) -> int:
        return self.floats.shape[1]

    def clear(self) -> None:
        """Make all as it is in new ones, in a quarter of the time that making them takes."""
        self.floats.fill(0.0)
        self.integers.fill(0)
        self.flags.fill(False)
        self.own_speed.fill(np.nan)
        self.distance.fill(np.nan)

    def keep(self, old: Cars, columns: Sequence[int]) -> None:
        """Take over these columns of `old` as the first ones."""
        k = len(columns)
        for mine, theirs in ((self.floats, old.floats), (self.integers, old.integers), (self.flags, old.flags)):
            mine[:, :k] = theirs[:, columns]
