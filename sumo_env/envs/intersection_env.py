"""highway-env's `IntersectionEnv` on SUMO."""

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import get_task


class IntersectionEnv(AbstractEnv):
    """The intersection, to be subclassed."""

    task = get_task("intersection")
