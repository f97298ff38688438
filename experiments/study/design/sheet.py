"""What is studied about a task, on one sheet a task: all that the study knows of a task by its name.

A task of your own has its sheet as an attribute (`own_task`, docs/own-parts.md). What is asked of a task without a
sheet is an error that names the file. `GRID` is the paper's 18 settings. `VARIANTS` are tasks under another
configuration.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import sumo_env
from agents.plugins import load_object, sha256, split
from experiments.support.errors import UserError, in_words
from sumo_env.tasks import TASKS, Task


@dataclass(frozen=True)
class Sheet:
    """What is studied about a task.

    return_range: largest difference between the returns of two episodes, for margins and the learner's checks.
    episode_length: mean length of a training episode [policy steps], which turns the paper's episodes into updates.
    updates, quick_updates: budgets of the study and of the preset quick, each update of batch_size transitions after
        steps_per_update environment steps.
    clock: a training clock longer than the test's, observed as a share [s]; None to train with the test's time limit.
    crossing: way from the start to just inside a crossing that the task is about [m]; None without one.
    lane_changes: whether the traffic changes lanes, as a measure of the validation. egos_without: egos that the
        validation leaves out.
    """

    return_range: float
    episode_length: int
    updates: int = 15_000
    quick_updates: int = 2500
    steps_per_update: int = 4
    batch_size: int = 128
    clock: int | None = None
    crossing: float | None = None
    lane_changes: bool = True
    egos_without: frozenset[str] = frozenset()


# With a clock the time limit is terminal in training, and the time observed. The roundabout's reward pays for standing
# at the entry: with values beyond the limit, waiting is worth more than driving, and agents learn to wait. On u-turn
# and two-way road nothing is ever learnt of the places where the limit ends an episode, so that the values beyond it,
# guessed there, grow up to the bound of an endless drive (docs/learner.md). On roundabout and u-turn the longer clocks
# end before an ego at the highest speed leaves the road.
SHEETS: dict[str, Sheet] = {
    "highway": Sheet(
        return_range=20.0,  # at most 1 a step for 20 s
        episode_length=17,
        updates=16_000,
        quick_updates=3000,
        steps_per_update=3,
        batch_size=64,
    ),
    # Drivers keep their lane. The ego starts at its top speed, so that "faster" would be "idle" again.
    "two-way": Sheet(
        return_range=15.0,
        episode_length=6,
        updates=30_000,
        quick_updates=3000,
        steps_per_update=2,
        batch_size=64,
        clock=20,
        lane_changes=False,
        egos_without=frozenset({"faster"}),
    ),
    "roundabout": Sheet(
        return_range=11.0,
        episode_length=10,
        quick_updates=4000,
        clock=15,
        crossing=24.5,  # an ego's length beyond the entry
    ),
    "intersection": Sheet(
        return_range=14.0,  # -5 to 9
        episode_length=9,
        quick_updates=1900,
        crossing=45.0,
        lane_changes=False,
        egos_without=frozenset({"faster", "weaving"}),  # the ego starts at its top speed
    ),
    "u-turn": Sheet(
        return_range=10.0,
        episode_length=9,
        quick_updates=1500,
        clock=13,
    ),
    # In no published study. The ego starts at its top speed.
    "merge": Sheet(
        return_range=17.0,  # at most 1 a step, and 17 steps to the end at the lowest speed
        episode_length=13,
        egos_without=frozenset({"faster"}),
    ),
    # In no published study. Drivers keep their lanes, as on the two-way road.
    "exit": Sheet(
        return_range=11.0,  # 1 a step from 400 m on, which is reached after 9 of 18 steps at the highest speed
        episode_length=17,
        lane_changes=False,
    ),
}
# The paper's settings: names of the traffic levels by task, the lightest first.
GRID: dict[str, tuple[str, ...]] = {
    "highway": ("50", "100", "150"),
    "two-way": ("5+2", "10+4", "15+6"),
    "roundabout": ("5", "10", "15"),
    "intersection": ("10", "15", "20", "25", "30"),
    "u-turn": ("3", "6", "9", "12"),
}


class Variant(NamedTuple):
    """A task under another configuration, studied as a task beside it: on its sheet, at its levels, in its scenarios.

    changes: keys of the environments' configuration with their values.
    """

    task: str
    changes: Mapping[str, Any]


VARIANTS: dict[str, Variant] = {
    # highway-env's slowest target speed is 20 m/s, the highest that others on the two-way road want: whoever waits
    # behind them runs into them.
    "two-way-brakes": Variant(
        "two-way", {"action": {"type": "DiscreteMetaAction", "target_speeds": [10, 20, 30]}}
    ),
}


def task_of(name: str) -> str:
    """The task of the simulators that a task of the study is, which may be a variant."""
    return VARIANTS[name].task if name in VARIANTS else name


def sheet(task: str) -> Sheet:
    """The sheet of a task. Raises UserError for a task that has none."""
    task = task_of(task)
    if task not in SHEETS:
        raise UserError(
            f"nothing is said of the task {task!r} in SHEETS of experiments/study/design/sheet.py, so that it cannot "
            f"be studied: add its sheet there (there are {', '.join(SHEETS)})"
        )
    return SHEETS[task]


class OwnTask(str):
    """The name of a task in a user's file. Every process that it is sent to has the task then."""

    where: tuple[str, str]  # FILE:TASK, and the SHA-256 of the file

    def __reduce__(self) -> Any:
        return own_task, self.where


@in_words()
def own_task(source: str, digest: str = "") -> OwnTask:
    """Add the task of "FILE:TASK" to those that there are, with its attribute `sheet` and the id sumo/NAME-v0.

    digest: SHA-256 of the file, where it is known.

    Raises:
        UserError: there is no such task, it has no sheet, its name is taken, or the file has changed.
    """
    file, name = split(source)
    where = f"{file.absolute()}:{name}", sha256(file)
    if digest not in ("", where[1]):
        raise UserError(f"{file} has changed since this command began: run the command again")
    there = {own.where: own for own in TASKS if isinstance(own, OwnTask)}
    if where not in there:
        found = load_object(source)
        task = found() if isinstance(found, type) else found
        about = getattr(task, "sheet", None)
        if not isinstance(task, Task) or not isinstance(about, Sheet):
            raise UserError(
                f"{source} must be a sumo_env.Task with an attribute sheet, an "
                "experiments.study.design.sheet.Sheet(return_range=..., episode_length=...)"
            )
        if task.name in TASKS or task.name in VARIANTS:
            raise UserError(f"{source}: there is a task {task.name!r} already, choose another name")
        there[where] = own = OwnTask(task.name)
        own.where = where
        TASKS[own], SHEETS[own] = task, about
        sumo_env.register(f"sumo/{own}-v0", task)
    return there[where]
