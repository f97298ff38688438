"""highway-env's `HighwayEnv` and `HighwayEnvFast` on SUMO."""

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import get_task


class HighwayEnv(AbstractEnv):
    """The highway, to be subclassed."""

    task = get_task("highway")


class HighwayEnvFast(HighwayEnv):
    """The highway with the defaults of highway-fast-v0: fewer lanes, vehicles and simulation steps."""

    task = get_task("highway-fast")
