"""The tasks on SUMO as classes to derive from, under the names of ``highway_env.envs`` and its modules."""

import sys

from sumo_env.envs.common.abstract import AbstractEnv
from sumo_env.tasks import TASKS, get_task

__all__ = [
    "ExitEnv",
    "HighwayEnv",
    "HighwayEnvFast",
    "IntersectionEnv",
    "MergeEnv",
    "RoundaboutEnv",
    "TwoWayEnv",
    "UTurnEnv",
]


class ExitEnv(AbstractEnv):
    """The exit, to be subclassed."""

    task = get_task("exit")


class HighwayEnv(AbstractEnv):
    """The highway, to be subclassed."""

    task = get_task("highway")


class HighwayEnvFast(HighwayEnv):
    """The highway with the defaults of highway-fast-v0: fewer lanes, vehicles and simulation steps."""

    task = get_task("highway-fast")


class IntersectionEnv(AbstractEnv):
    """The intersection, to be subclassed."""

    task = get_task("intersection")


class MergeEnv(AbstractEnv):
    """The merge, to be subclassed."""

    task = get_task("merge")


class RoundaboutEnv(AbstractEnv):
    """The roundabout, to be subclassed."""

    task = get_task("roundabout")


class TwoWayEnv(AbstractEnv):
    """The two-way road, to be subclassed."""

    task = get_task("two-way")


class UTurnEnv(AbstractEnv):
    """The u-turn, to be subclassed."""

    task = get_task("u-turn")


for _task in TASKS.values():  # highway-env has a module for each
    _module = type(_task).__module__.rpartition(".")[2]
    sys.modules[f"{__name__}.{_module}_env"] = sys.modules[__name__]
