"""The frozen test of `sumo_env.benchmark` driven, in parallel processes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from typing import Any

import gymnasium as gym
import pandas as pd

from experiments.study.compute.entrants import Entrant, Place
from experiments.study.compute.evaluate import play_from
from experiments.study.compute.executors import cores
from experiments.study.compute.executors.local import LocalExecutor
from experiments.study.design.arms import stream_seed
from experiments.study.results.schema import COLUMNS
from sumo_env.benchmark import BenchmarkScenario, digest


def drive(entrant: Entrant, scenarios: Sequence[BenchmarkScenario]) -> tuple[pd.DataFrame, str]:
    """The episodes of one task, level and traffic, with its name, and the digest of their scenarios."""
    rows, drawn, first = [], [], scenarios[0]
    with closing(_env(first)) as env:
        seen, policy = entrant.make(env)
        for one in scenarios:
            policy.reset(stream_seed("frozen test", one.group, one.number))
            rows.append({"scenario": one.number, **play_from(seen, policy, one.seed, one.options)})
            drawn.append(env.unwrapped.scenario)
    frame = pd.DataFrame(rows).assign(task=first.task, level=first.level, traffic=first.traffic)
    return frame.astype(COLUMNS), digest(drawn)


def _env(of: BenchmarkScenario) -> Any:
    return gym.make(f"sumo_env:{of.id}", config=of.config)


def resolved(
    who: Mapping[Place, Entrant], groups: Mapping[str, list[BenchmarkScenario]]
) -> dict[Place, Entrant]:
    """Who drives in these groups of scenarios, with digests; each has driven one of its scenarios.

    Raises:
        UserError: a policy cannot be made, or does not fit an environment.
    """
    found: dict[Place, Entrant] = {}
    for own in groups.values():
        place = own[0].task, own[0].level
        if place not in found:
            with closing(_env(own[0])) as env:
                found[place] = who[place].resolved(env)
            drive(found[place], own[:1])
    return found


def take(
    who: Mapping[Place, Entrant], groups: Mapping[str, list[BenchmarkScenario]]
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Drive groups of scenarios in processes; returns all episodes, and the digest of each group's scenarios.

    who: as `resolved`.
    """
    executor = LocalExecutor(cores())
    frames, digests = [], {}
    try:
        futures = {
            group: executor.submit(drive, who[own[0].task, own[0].level], own)
            for group, own in groups.items()
        }
        for group, future in futures.items():
            frame, digests[group] = future.result()
            frames.append(frame)
            print(f"{len(frames)}/{len(groups)} groups of scenarios: {group}", flush=True)
    finally:
        executor.shutdown(cancel_futures=True)
    return pd.concat(frames), digests
