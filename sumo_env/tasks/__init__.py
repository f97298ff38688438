"""The tasks by name. All that is known of a task by its name follows from its class: ids, roads, levels."""

from sumo_env.config import ConfigError, nearest
from sumo_env.tasks.base import Task
from sumo_env.tasks.exit import Exit
from sumo_env.tasks.highway import FAST, Highway
from sumo_env.tasks.intersection import Intersection
from sumo_env.tasks.merge import Merge
from sumo_env.tasks.roundabout import Roundabout
from sumo_env.tasks.two_way import TwoWay
from sumo_env.tasks.u_turn import UTurn

TASKS: dict[str, Task] = {
    task.name: task for task in (Highway(), TwoWay(), Roundabout(), Intersection(), UTurn(), Merge(), Exit())
}

# Names that stand for a task with other defaults.
VARIANTS: dict[str, Task] = {"highway-fast": Highway(FAST)}


def get_task(name: str | Task) -> Task:
    """The task of this name, highway-fast among them; a task stands for itself.

    Raises:
        ConfigError: there is none; the message names the nearest one.
    """
    if isinstance(name, Task):
        return name
    if isinstance(name, type) and issubclass(name, Task):
        raise ConfigError(f"a task is needed, not its class: {name.__name__}()")
    if not isinstance(name, str):
        raise ConfigError(f"a task is a name, such as 'highway', or a Task, not {name!r}")
    if name not in TASKS | VARIANTS:
        raise ConfigError(f"unknown task {name!r}: {nearest(name, list(TASKS))}")
    return (TASKS | VARIANTS)[name]
