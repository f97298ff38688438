"""The five tasks on SUMO as classes to derive from, under the names of ``highway_env.envs`` and its modules."""

import sys

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import get_task

__all__ = ["HighwayEnv", "HighwayEnvFast", "IntersectionEnv", "RoundaboutEnv", "TwoWayEnv", "UTurnEnv"]


class HighwayEnv(AbstractEnv):
    """The highway, to be subclassed."""

    task = get_task("highway")


class HighwayEnvFast(HighwayEnv):
    """The highway with the defaults of highway-fast-v0: fewer lanes, vehicles and simulation steps."""

    task = get_task("highway-fast")


class IntersectionEnv(AbstractEnv):
    """The intersection, to be subclassed."""

    task = get_task("intersection")


class RoundaboutEnv(AbstractEnv):
    """The roundabout, to be subclassed."""

    task = get_task("roundabout")


class TwoWayEnv(AbstractEnv):
    """The two-way road, to be subclassed."""

    task = get_task("two-way")


class UTurnEnv(AbstractEnv):
    """The u-turn, to be subclassed."""

    task = get_task("u-turn")


for _module in ("highway_env", "intersection_env", "roundabout_env", "two_way_env", "u_turn_env"):
    sys.modules[f"{__name__}.{_module}"] = sys.modules[__name__]  # highway-env has a module for each
