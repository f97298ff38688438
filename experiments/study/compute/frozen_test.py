"""The test of `sumo_env.benchmark` driven, in parallel processes."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from typing import Any

import gymnasium as gym
import pandas as pd

from agents.policies import Policy
from experiments.study.compute.entrants import Entrant, Place
from experiments.study.compute.evaluate import play_from
from experiments.study.compute.executors import cores
from experiments.study.compute.executors.local import LocalExecutor
from experiments.study.design.arms import stream_seed
from experiments.study.design.levels import level_config
from experiments.study.design.sheet import task_of
from experiments.study.results.schema import COLUMNS
from experiments.support.errors import UserError, in_a_line
from sumo_env.benchmark import BenchmarkScenario, benchmark_scenarios, digest


def scenarios_of(task: str, quick: bool) -> list[BenchmarkScenario]:
    """The scenarios of a task, or of a variant: those of its task, under its configuration."""
    found = benchmark_scenarios([task_of(task)], quick)
    return [one._replace(task=task, config=level_config(task, one.level)) for one in found]


def drive(entrant: Entrant, scenarios: Sequence[BenchmarkScenario]) -> tuple[pd.DataFrame, str]:
    """The episodes of one task, level and traffic, with its name, and the digest of their scenarios."""
    rows, drawn, first = [], [], scenarios[0]
    with closing(opened(first, entrant)) as env:
        seen, policy = entrant.make(env)
        for one in scenarios:
            rows.append({"scenario": one.number, **episode(entrant, seen, policy, one)})
            drawn.append(env.unwrapped.scenario)
    frame = pd.DataFrame(rows).assign(task=first.task, level=first.level, traffic=first.traffic)
    return frame.astype(COLUMNS), digest(drawn)


def episode(
    entrant: Entrant,
    env: Any,
    policy: Policy,
    one: BenchmarkScenario,
    on_step: Callable[[], None] | None = None,
) -> dict[str, Any]:
    """An episode as `play_from` returns it. env, policy: what the entrant has made.

    Raises:
        UserError: the policy failed.
    """
    try:
        policy.reset(stream_seed("frozen test", one.group, one.number))
        return play_from(env, policy, one.seed, one.options, on_step)
    except (Exception, SystemExit) as error:  # whatever somebody's policy does
        where = f"{entrant.name} in scenario {one.number} of {one.group}"
        raise UserError(f"{where}: {in_a_line(error)}") from error


def opened(of: BenchmarkScenario, driver: Entrant, render_mode: str | None = None, **view: Any) -> Any:
    """The environment of a scenario, as its driver observes it. view: keys of its pictures."""
    config = {**of.config, **driver.config, **view}
    return gym.make(f"sumo_env:{of.id}", config=config, render_mode=render_mode)


def resolved(
    who: Mapping[Place, Entrant], groups: Mapping[str, list[BenchmarkScenario]]
) -> dict[Place, Entrant]:
    """Who drives in these groups of scenarios, with digests; each has driven one of its scenarios.

    Raises:
        UserError: a policy cannot be made, or does not fit an environment; the message says of which task.
    """
    found: dict[Place, Entrant] = {}
    for own in groups.values():
        place = own[0].task, own[0].level
        if place not in found:
            with closing(opened(own[0], who[place])) as env:
                try:
                    found[place] = who[place].resolved(env)
                except UserError as error:
                    raise UserError(f"{place[0]} {place[1]}: {error} (--tasks chooses tasks)") from error
            drive(found[place], own[:1])
    return found


def take(
    who: Mapping[Place, Entrant], groups: Mapping[str, list[BenchmarkScenario]], workers: int | None = None
) -> tuple[dict[str, tuple[pd.DataFrame, str]], dict[str, str]]:
    """Drive groups of scenarios in processes, one a core unless said. who: as `resolved`.

    Returns:
        What `drive` returns of each group, and of those that could not be driven the reason.
    """
    executor = LocalExecutor(min(workers or cores(), len(groups)))
    found, failed = dict[str, tuple[pd.DataFrame, str]](), dict[str, str]()
    try:
        futures = {
            name: executor.submit(drive, who[own[0].task, own[0].level], own) for name, own in groups.items()
        }
        for number, (name, future) in enumerate(futures.items(), 1):
            if (error := future.exception()) is None:
                found[name] = future.result()
            else:
                failed[name] = in_a_line(error)
            said = f"failed: {failed[name]}" if name in failed else name
            print(f"{number}/{len(groups)} groups of scenarios: {said}", flush=True)
    finally:
        executor.shutdown(cancel_futures=True)
    return found, failed
