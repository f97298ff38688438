"""highway-env's `UTurnEnv` on SUMO."""

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import get_task


class UTurnEnv(AbstractEnv):
    """The u-turn, to be subclassed."""

    task = get_task("u-turn")
