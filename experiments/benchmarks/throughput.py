"""Agents an hour: training and test, end to end, extrapolated from short trainings in every traffic.

One agent of each arm is trained for a short budget by `agents.training.train` and tested by
`experiments.study.evaluate.evaluate`, as a sweep does. What an update with its environment steps costs is taken
after the start-up (warm-up, first block), what a test episode costs from some; an agent of the preset `standard`
costs so many of both as that says. Nothing is trained for hours here: trained agents live longer than
beginners, so that their steps hold fewer resets and, on the highway, more vehicles that change lane.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any

from experiments.benchmarks.remote import Remote, Slice, Stopwatch, total
from experiments.study.grid import ARMS, level_names

Record = dict[str, Any]
Cost = tuple[float, float]  # seconds for an update with its environment steps, and for a test episode
Place = tuple[str, int]  # task and level


class Trainee:
    """Trains and tests for a short while; lives in its own process."""

    def measure(self, task: str, level: int, updates: int, episodes: int) -> tuple[Cost, Cost]:
        """Cost of an update with its steps and of a test episode, means over the arms and traffics.

        First in wall time, then in processor time [s].
        """
        from agents.dqn import DQNConfig
        from agents.training import Progress, train
        from experiments.backends import make_env
        from experiments.benchmarks.environments import level_config
        from experiments.study.evaluate import evaluate

        env = make_env("sumo", task, level_config("sumo", task, level))
        watch = Stopwatch()
        marks: list[Slice] = []

        def mark(progress: Progress) -> None:
            marks.append(watch.slice(progress.updates))

        config = DQNConfig(updates=updates, warm_up=20)
        stretches = []
        for risk in ARMS.values():
            marks.clear()
            agent = train(env, config, 0, reset_options={"config": {"risk": risk}}, progress=mark)
            first, last = marks[0], marks[-1]
            stretches.append(Slice(last.count - first.count, last.wall - first.wall, last.cpu - first.cpu))
        learned, policy = total(stretches), agent.policy
        evaluate(env, policy, task, level, 1)
        watch = Stopwatch()
        evaluate(env, policy, task, level, episodes)
        tested = watch.slice(2 * episodes)
        env.close()
        return (
            (learned.wall / learned.count, tested.wall / tested.count),
            (learned.cpu / learned.count, tested.cpu / tested.count),
        )


def measure_sweep(
    places: Sequence[Place], workers: Sequence[int], updates: int, episodes: int, note: Callable[[str], None]
) -> list[Record]:
    """Agents an hour over the 18 settings for each number of workers, which train at the same time.

    Levels that are not in `places` are taken to cost what lies, by level number, between the measured ones.
    """
    wall: dict[int, dict[Place, Cost]] = {count: {} for count in workers}
    cpu: dict[int, dict[Place, Cost]] = {count: {} for count in workers}
    with ExitStack() as stack:
        crew = [stack.enter_context(Remote(Trainee)) for _ in range(max(workers))]
        for task, level in places:
            for count in workers:
                note(f"training, {count} at a time, {task} {level_names(task)[level - 1]}")
                for worker in crew[:count]:
                    worker.start("measure", task, level, updates, episodes)
                results: list[tuple[Cost, Cost]] = [worker.result() for worker in crew[:count]]
                wall[count][task, level] = _mean([result[0] for result in results])
                cpu[count][task, level] = _mean([result[1] for result in results])
    return [
        {
            "workers": count,
            "agents_per_hour": count * 3600.0 / agent_seconds(wall[count]),
            "agents_per_hour_on_free_cores": count * 3600.0 / agent_seconds(cpu[count]),
            "extrapolated": True,
            "measured_updates": updates,
            "costs": [
                {
                    "task": task,
                    "level": level_names(task)[level - 1],
                    "ms_per_update_and_step": 1e3 * step,
                    "ms_per_test_episode": 1e3 * test,
                    "agent_minutes": _seconds(task, (step, test)) / 60.0,
                }
                for (task, level), (step, test) in wall[count].items()
            ],
        }
        for count in workers
    ]


def _mean(costs: Sequence[Cost]) -> Cost:
    return statistics.fmean(step for step, _ in costs), statistics.fmean(test for _, test in costs)


def agent_seconds(costs: Mapping[Place, Cost]) -> float:
    """Mean time of one agent over the 18 settings [s], of the tasks that were measured."""
    times = []
    for task in dict.fromkeys(task for task, _ in costs):
        known = {level: cost for (name, level), cost in costs.items() if name == task}
        for level in range(1, len(level_names(task)) + 1):
            times.append(_seconds(task, _between(known, level)))
    return statistics.fmean(times)


def _seconds(task: str, cost: Cost) -> float:
    """Time of an agent with the budget of the preset `standard` [s]."""
    from experiments.study.presets import PRESETS

    preset = PRESETS["standard"]
    return preset.updates[task] * cost[0] + (2 * preset.episodes + preset.gate_episodes) * cost[1]


def _between(known: Mapping[int, Cost], level: int) -> Cost:
    """Cost at a level: linear between the nearest measured ones, that of the nearest beyond them."""
    import numpy as np

    levels = sorted(known)
    step, test = (float(np.interp(level, levels, [known[n][k] for n in levels])) for k in (0, 1))
    return step, test
