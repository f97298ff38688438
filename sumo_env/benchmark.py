"""The frozen test: scenarios that any policy can be put through, the same for everybody (docs/benchmark.md).

Tasks, levels, traffics and seeds are written here. What is drawn from them follows from the code of the tasks:
benchmark.json has digests of it, so that a set that has changed is not taken for this one. After a change that is
meant, ``python -m sumo_env.benchmark`` writes them anew.

Policies of other tasks are tested in the same way; their scenarios are not frozen.
"""

import json
from collections.abc import Iterable
from contextlib import closing
from dataclasses import fields, is_dataclass, replace
from hashlib import sha256
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym

from sumo_env.config import ConfigError, names_of, nearest
from sumo_env.tasks import TASKS
from sumo_env.traffic.drivers import UNCALIBRATED
from sumo_env.traffic.risk import RATES
from sumo_env.traffic.scenario import Scenario

SETTINGS = {  # the lightest and the densest level of each task
    "highway": ("50", "150"),
    "two-way": ("5+2", "15+6"),
    "roundabout": ("5", "15"),
    "intersection": ("10", "30"),
    "u-turn": ("3", "12"),
}
RISKY = {"config": {"risk": 1.0, "drivers": "highway-env"}}
TRAFFICS: dict[str, dict[str, Any]] = {  # options of `reset`
    "regular": {"config": {"risk": 0.0, "drivers": "highway-env"}},
    "risky": RISKY,
    "no-events": {**RISKY, "risk_rates": dict.fromkeys(RATES, 0.0)},  # risky drivers
    "measured": {"config": {"risk": 0.0, "drivers": "measured"}},
}
FIRST_SEED = 2**33  # above those of the study
SIZE, QUICK = 200, 40  # scenarios of each setting and traffic
STORED = Path(__file__).with_name("benchmark.json")


class BenchmarkScenario(NamedTuple):
    """One scenario of the frozen test. One environment drives all of a task and level, in any order.

    >>> env = gym.make(scenario.id, config=scenario.config)
    >>> env.reset(seed=scenario.seed, options=scenario.options)

    Scenarios of one task, level and number have the same places in every traffic.
    """

    id: str
    config: dict[str, Any]
    seed: int
    options: dict[str, Any]
    task: str
    level: str
    traffic: str
    number: int

    @property
    def group(self) -> str:
        """Task, level and traffic: "u-turn-3-risky"."""
        return f"{self.task}-{self.level}-{self.traffic}"


def benchmark_scenarios(tasks: Iterable[str] = (), quick: bool = False) -> list[BenchmarkScenario]:
    """The scenarios of the frozen test, group by group.

    Args:
        tasks: the five tasks of the frozen test by default; of others the scenarios are those of today's code.
        quick: the first 40 of the 200 scenarios of each group.

    Raises:
        ConfigError: there is no such task.
    """
    for task in (asked := names_of("tasks", tasks)):
        if task not in TASKS:
            raise ConfigError(f"there is no task {task!r}: {nearest(task, TASKS)}")
    found = []
    for task in (one for one in TASKS if one in (asked or SETTINGS)):
        for level in levels_of(task):
            reset, seed = (f"sumo/{task}-v0", dict(TASKS[task].levels[level])), _first_seed(task, level)
            found += [
                BenchmarkScenario(*reset, seed + number, options, task, level, traffic, number)
                for traffic, options in TRAFFICS.items()
                for number in range(QUICK if quick else SIZE)
            ]
    return found


def levels_of(task: str) -> tuple[str, ...]:
    """The lightest and the densest level of a task, if it has two."""
    names = list(TASKS[task].levels)
    return SETTINGS.get(task) or tuple(dict.fromkeys((names[0], names[-1])))


def _first_seed(task: str, level: str) -> int:
    """Settings of the frozen test share no seeds; those of another task have the first ones."""
    frozen = [(name, one) for name, levels in SETTINGS.items() for one in levels]
    number = frozen.index((task, level)) if task in SETTINGS else levels_of(task).index(level)
    return FIRST_SEED + SIZE * number


def digest(drawn: Iterable[Scenario]) -> str:
    """Eight digits of what was drawn (``env.unwrapped.scenario`` after a reset), the same on every processor.

    SUMO's calibration is no part of it: it decides how the traffic drives.
    """
    texts = [_text(replace(one, pools=(), calibration=UNCALIBRATED)) for one in drawn]
    return sha256("\n".join(texts).encode()).hexdigest()[:8]


def stored(group: str, quick: bool = False) -> str:
    """The digest of the scenarios of a group as they were frozen; empty for one that was not."""
    digests = json.loads(STORED.read_text()).get(group, ["", ""])
    return str(digests[0 if quick else 1])


def _text(value: Any) -> str:
    """A value in words; numbers are rounded far above what processors differ by, and defaults left out."""
    if isinstance(value, float):
        return f"{round(value, 4) + 0.0:.4f}"
    if isinstance(value, tuple):
        return " ".join(map(_text, value))
    if is_dataclass(value):
        own = [(one.name, part) for one in fields(value) if (part := getattr(value, one.name)) != one.default]
        return " ".join(f"{name} {_text(part)}" for name, part in own)
    return str(value)


def main() -> None:
    """Write the digests of all groups: of the quick scenarios, and of all."""
    lines = []
    for group, scenarios in groupby(benchmark_scenarios(), lambda one: one.group):
        first, *others = scenarios
        with closing(gym.make(first.id, config=first.config)) as env:
            drawn = []
            for one in (first, *others):
                env.reset(seed=one.seed, options=one.options)
                drawn.append(env.unwrapped.scenario)  # type: ignore[attr-defined]
        lines.append(f" {json.dumps(group)}: {json.dumps([digest(drawn[:QUICK]), digest(drawn)])}")
    STORED.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main()
