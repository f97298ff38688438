"""Tasks and their traffic levels, numbered from the lightest, and the configuration of the environment at each.

A task here may be a variant of one (`sheet.VARIANTS`).
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from tyro.constructors import PrimitiveConstructorSpec

from experiments.study.design.sheet import GRID, VARIANTS, own_task, sheet, task_of
from experiments.support.arguments import argument
from experiments.support.errors import UserError, check_known
from sumo_env.config import TYPES, resolve
from sumo_env.spaces.approach import APPROACH
from sumo_env.spaces.observation import FEATURES, USUAL
from sumo_env.tasks import TASKS

# highway-env's own time step, and drivers that see along their path (see `backends.highway_env`).
HIGHWAY_ENV = {"simulation_frequency": 15, "variant": "path"}
BACKEND_KEYS = ("variant", "risk_law")  # keys that only the replica and highway-env have
# Keys of the environments that say how an episode is drawn or which arm is meant, not what is simulated.
PICTURES = {"screen_width", "screen_height", "scaling", "centering_position"}
FREE = {"risk", "drivers", *PICTURES}


def tasks_known() -> tuple[str, ...]:
    """All tasks in the order of TASKS, each before its variants."""
    return tuple(sorted((*TASKS, *VARIANTS), key=lambda name: [*TASKS].index(task_of(name))))


# A task by its name, or one of the user's own.
TaskName = Annotated[
    str,
    PrimitiveConstructorSpec(
        nargs=1,
        metavar="TASK",
        instance_from_str=lambda words: own_task(words[0]) if ":" in words[0] else words[0],
        is_instance=lambda value: isinstance(value, str),
        str_from_instance=lambda value: [value],
    ),
]
StudyTasks = Annotated[
    tuple[TaskName, ...],
    argument(
        "TASK ...", "those of the study", f"Some of {', '.join(tasks_known())}, or FILE:TASK, your own."
    ),
]
# of commands that read stored results
OwnTasks = Annotated[
    tuple[TaskName, ...], argument("FILE:TASK ...", help="Tasks of your own that are in the results.")
]


def level_names(task: str) -> tuple[str, ...]:
    """Names of a task's traffic levels, lightest first ("50", "100", "150"); levels are numbered from 1."""
    return tuple(TASKS[task_of(task)].levels)


def level_config(task: str, name: str) -> dict[str, Any]:
    """What a task, or a variant of one, has configured at a level."""
    changes = VARIANTS[task].changes if task in VARIANTS else {}
    return {**TASKS[task_of(task)].levels[name], **changes}


def env_config(
    backend: str, task: str, level: int, changes: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The complete configuration of a task at a traffic level, without the dose of risk.

    Defaults are written out, so that a changed default makes other cells. changes: keys that are set to other values;
    "observation.features" is a key of the entry "observation", whose others stay.

    Raises:
        UserError: a key of another backend, or that cannot be set. ConfigError: an unknown key or a wrong value.
    """
    names = level_names(task)
    common = dict(changes or {})
    own = {name: common.pop(name) for name in BACKEND_KEYS if name in common}
    if own and backend == "sumo":
        raise UserError(f"{', '.join(own)} is a key of the backends replica and highway-env, not of sumo")
    if free := FREE.intersection(common):
        raise UserError(
            f"{', '.join(sorted(free))} cannot be set for an experiment: it is drawn or has no meaning there"
        )
    of_level, defaults = level_config(task, names[level - 1]), TASKS[task_of(task)].defaults
    for name in [name for name in common if name.partition(".")[0] in TYPES and "." in name]:
        entry, _, key = name.partition(".")
        whole = {**defaults, **of_level, **common}[entry]
        common[entry] = {**whole, key: common.pop(name)}
    config = resolve(task_of(task), defaults, of_level, common)
    action = config["action"]
    if action["type"] != "DiscreteMetaAction" or action.get("longitudinal", True) is not True:
        raise UserError(
            "agents of a study choose meta-actions, SLOWER and FASTER among them, as the drivers do that they are "
            f"compared with: {action} has others"
        )
    config = {name: value for name, value in config.items() if name not in FREE}
    return {**config, **({} if backend == "sumo" else HIGHWAY_ENV), **own}


def is_usual(backend: str, task: str, level: int, config: Mapping[str, Any]) -> bool:
    """Whether a configuration is that of a task at a level, but for what is observed."""
    return {**config, "observation": None} == {**env_config(backend, task, level), "observation": None}


def with_features(task: str, more: Sequence[str]) -> dict[str, Any]:
    """The change of the configuration after which a table of vehicles has these features beside the task's own.

    Raises:
        UserError: an unknown feature.
    """
    check_known("feature", more, (*FEATURES, *APPROACH))
    own = env_config("sumo", task, 1)["observation"]
    if own["type"] not in ("Kinematics", "ExitObservation") or not more:
        return {}
    return {"observation.features": [*dict.fromkeys((*(own.get("features") or USUAL), *more))]}


def choose_tasks(wanted: Sequence[str], variants: bool = False) -> tuple[str, ...]:
    """The wanted tasks, or those of the study, in the order of `tasks_known`.

    variants: whether variants of tasks are known.

    Raises:
        UserError: a task that is not known, or without a sheet.
    """
    wanted, known = wanted or tuple(GRID), tasks_known() if variants else tuple(TASKS)
    check_known("task", wanted, known)
    for task in wanted:
        sheet(task)
    return tuple(task for task in known if task in wanted)


def choose_levels(tasks: Sequence[str], wanted: Sequence[int]) -> dict[str, tuple[int, ...]]:
    """Level numbers of each task: the wanted ones that it has, or all.

    Raises:
        UserError: a level that none of the tasks has.
    """
    known = {task: range(1, len(level_names(task)) + 1) for task in tasks}
    check_known("level number", wanted, range(1, 1 + max(map(len, known.values()))))
    chosen = {task: tuple(n for n in known[task] if not wanted or n in wanted) for task in tasks}
    return {task: numbers for task, numbers in chosen.items() if numbers}
