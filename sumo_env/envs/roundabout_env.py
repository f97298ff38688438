"""highway-env's `RoundaboutEnv` on SUMO."""

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import get_task


class RoundaboutEnv(AbstractEnv):
    """The roundabout, to be subclassed."""

    task = get_task("roundabout")
