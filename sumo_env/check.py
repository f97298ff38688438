"""What a task of a user's own has to keep to, as one function that says what is wrong: `check_task`."""

import math
from collections.abc import Iterator, Mapping
from contextlib import closing
from typing import Any

import numpy as np

from sumo_env.config import Config, ConfigError, resolve
from sumo_env.env import DrivingEnv
from sumo_env.tasks.base import Task
from sumo_env.traffic.scenario import EGO, Scenario

SEEDS = (0, 1)


def check_task(task: Task, config: Mapping[str, Any] | None = None, steps: int = 20) -> None:
    """Draw scenarios of a task by its defaults and at each level, drive short episodes on SUMO, and say what is wrong.

    Beside what every `reset` refuses: a seed repeats its episode; the dose of risk moves no vehicle; vehicles stand on
    lanes of the road, and events are theirs; terms of the reward are finite, are the same ones at every step, and have
    a weight.

    Args:
        task: such as ``Rush()`` in docs/own-parts.md.
        config: keys that differ from the task's defaults and from its levels. steps: policy steps of an episode, at
            most.

    Raises:
        ConfigError: what is wrong, a line for each fault. Whatever the task itself raises is not caught, and has a note
            that names the level.
    """
    if not isinstance(task, Task):
        raise ConfigError(f"a task is an instance of a subclass of Task, not {task!r}")
    driven: list[Config] = []
    for level, own in {"": {}, **task.levels}.items():
        values = resolve(task.name, task.defaults, own, config)
        if values in driven:
            continue
        driven.append(values)
        where = f"the task {task.name!r}" + (f" at the level {level!r}" if level else "")
        try:
            faults = list(dict.fromkeys(_faults_of_scenarios(task, values)))
            for dose in dict.fromkeys((values["risk"], 1.0)):  # events act at 1
                if not faults:
                    at = {**values, "risk": dose}
                    faults = list(dict.fromkeys(_faults_of_episodes(task, at, steps)))
        except Exception as error:
            error.add_note(f"in an episode of {where}")
            raise
        if faults:
            raise ConfigError("\n  ".join([f"{where} has {len(faults)} fault(s):", *faults]))


def _faults_of_scenarios(task: Task, config: Config) -> Iterator[str]:
    gaps = np.diff(task.target_speeds)
    if (gaps <= 0).any() or not np.allclose(gaps, gaps[:1], rtol=0.01):
        yield f"target_speeds are not evenly spaced and ascending: {task.target_speeds}"
    for seed in SEEDS:
        drawn, again = (task.scenario(config, seed) for _ in range(2))
        if drawn != again:
            yield "a seed gives two scenarios: draw from rng, drivers or sumo_env.streams.stream(seed, name) alone"
        doses = [_places(task.scenario({**config, "risk": dose}, seed)) for dose in (0.0, 1.0)]
        if doses[0] != doses[1]:
            yield "the dose of risk moves vehicles: places, speeds and arrivals must not depend on config['risk']"
        if drawn.ego.id != EGO:
            yield f"the ego is called {drawn.ego.id!r}, not {EGO!r}"
        lanes = task.road(config).lanes
        strangers = {event.vehicle for event in drawn.events} - {spec.id for spec in drawn.everybody}
        if strangers:
            yield f"events are of vehicles that never come: {sorted(strangers)}"
        for spec in drawn.everybody:
            if spec.lane not in lanes:
                yield f"the road has no lane {spec.lane!r} for {spec.id!r}: place it with make_on_lane"


def _places(scenario: Scenario) -> list[tuple[Any, ...]]:
    """All about its vehicles but their drivers."""
    steps = [spawn.step for spawn in scenario.spawns]
    return [tuple(steps), *(tuple(spec._replace(driver=scenario.ego.driver)) for spec in scenario.everybody)]


def _faults_of_episodes(task: Task, config: Config, steps: int) -> Iterator[str]:
    weighs_itself = type(task).reward is not Task.reward
    episodes: list[list[Any]] = []
    with closing(DrivingEnv(task, config)) as env:
        for _ in range(2):
            observation, _ = env.reset(seed=SEEDS[0])
            seen, names, over = [observation.tolist()], set(), False
            env.action_space.seed(0)
            for _ in range(steps):
                if over:
                    break
                observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
                seen += [observation.tolist(), reward]
                names.add(tuple(info["rewards"]))
                over = terminated or truncated
                for name, value in {**info["rewards"], "their sum": reward}.items():
                    if not math.isfinite(value):
                        yield f"the reward {name!r} is {value}"
            episodes.append(seen)
            if len(names) > 1:
                yield f"the terms of the reward differ between steps: {sorted(names)}"
            for name in set().union(*names) - {*config, "on_road_reward"}:
                if not weighs_itself:
                    yield f"the term {name!r} of the reward has no weight: add a key {name!r} to defaults"
    if repr(episodes[0]) != repr(episodes[1]):  # as text, for nan is not nan
        yield "a seed gives two episodes: the task remembers something of an earlier one"
