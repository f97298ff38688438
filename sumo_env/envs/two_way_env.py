"""highway-env's `TwoWayEnv` on SUMO."""

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import get_task


class TwoWayEnv(AbstractEnv):
    """The two-way road, to be subclassed."""

    task = get_task("two-way")
