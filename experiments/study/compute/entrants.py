"""Who takes the frozen test of `sumo_env.benchmark`, and how it is driven, in parallel processes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import pandas as pd

from agents import pretrained
from agents.files import DamagedFile
from agents.policies import Policy, foreign_policy
from agents.rules import MAKERS, POLICIES, make_policy
from experiments.study.compute.evaluate import play_from
from experiments.study.compute.executors import cores
from experiments.study.compute.executors.local import LocalExecutor
from experiments.study.compute.policies import driver
from experiments.study.design.arms import stream_seed
from experiments.study.results.schema import COLUMNS
from experiments.study.results.store import Store
from experiments.support.errors import UserError, in_words, unknown
from sumo_env.benchmark import SETTINGS, BenchmarkScenario, digest

RULES = tuple(dict.fromkeys((*POLICIES, *MAKERS)))
Env = gym.Env[Any, Any]
Place = tuple[str, str]  # task and level


class Entrant(NamedTuple):
    """Who drives at a task and level.

    place: that it was trained for. make: the policy for an environment, and that environment as it observes it; raises
    ValueError where it does not fit.
    """

    name: str
    place: Place
    make: Callable[[Env], tuple[Env, Policy]]


def entrants(policy: str, part: str = "") -> dict[Place, Entrant]:
    """Who drives at each task and level of the test.

    At a level that no agent was trained in it is one of the same task; tasks that no agent was trained in are not
    there. Of several agents it is the one that was finished last.

    Args:
        policy: a driver of `agents.rules`; a zip file of Stable-Baselines3 or FILE:MAKE, with {task} and {level} in its
            name; a directory of results; or an arm of `agents.cards()`, with or without its setting.
        part: of the agent's name in the directory.

    Raises:
        UserError: there is nobody of this name.
    """
    places = [(task, level) for task, levels in SETTINGS.items() for level in levels]
    if policy in RULES or policy.endswith(".zip") or ":" in policy:
        make = make_policy if policy in RULES else _foreign
        names = {at: policy.replace("{task}", at[0]).replace("{level}", at[1]) for at in places}
        return {at: Entrant(name, at, partial(_plain, make, name)) for at, name in names.items()}
    trained = _stored(Path(policy), part) if Path(policy).is_dir() else _published(policy)
    found = {}
    for at in places:
        if of_task := [one for one in trained if one.place[0] == at[0]]:
            found[at] = next((one for one in of_task if one.place == at), of_task[0])
    return found


def _plain(make: Callable[[str, Env], Policy], name: str, env: Env) -> tuple[Env, Policy]:
    return env, make(name, env)


def _foreign(name: str, env: Env) -> Policy:
    return foreign_policy(name, env)[0]


def _loaded(name: str, env: Env) -> tuple[Env, Policy]:
    setting, _, arm = name.partition("/")
    return env, pretrained.load(setting, arm)


def _stored(directory: Path, part: str) -> list[Entrant]:
    """The agents that have weights and this part in their names; the last one first."""
    store, found = Store(directory), dict[str, Entrant]()
    for name, record in store.records().items():
        key = record["key"]
        if part not in name or key["kind"] != "agent" or key["backend"] != "sumo":
            continue
        if weights := store.weights(name):
            make = partial(driver, key, None, weights=weights)
            found[record["timing"]["finished"] + name] = Entrant(name, (key["task"], key["level_name"]), make)
    if not found:
        named = f" and {part!r} in its name" if part else ""
        raise UserError(f"no agent in {directory} has weights{named}: experiments/train.py --out makes some")
    return [found[time] for time in sorted(found, reverse=True)]


def _published(policy: str) -> list[Entrant]:
    cards: dict[str, Any] = {}
    with suppress(FileNotFoundError):
        cards = pretrained.cards()
    found, arms = [], dict[str, None]()
    for name, about in cards.items():
        setting, _, arm = name.partition("/")
        arms[arm] = None
        if policy in (name, arm):
            place = about["task"], setting.removeprefix(f"{about['task']}-")
            found.append(Entrant(name, place, partial(_loaded, name)))
    if not found:
        raise unknown("policy", policy, [*RULES, *arms, "FILE:MAKE", "a zip file", "a directory"])
    return found


def drive(entrant: Entrant, scenarios: Sequence[BenchmarkScenario]) -> tuple[pd.DataFrame, str]:
    """The episodes of one task, level and traffic, with its name, and the digest of their scenarios."""
    rows, drawn, first = [], [], scenarios[0]
    env: Any = gym.make(f"sumo_env:{first.id}", config=first.config)
    with closing(env):
        with in_words((ValueError, DamagedFile)):
            seen, policy = entrant.make(env)
        for one in scenarios:
            policy.reset(stream_seed("frozen test", one.group, one.number))
            rows.append({"scenario": one.number, **play_from(seen, policy, one.seed, one.options)})
            drawn.append(env.unwrapped.scenario)
    frame = pd.DataFrame(rows).assign(task=first.task, level=first.level, traffic=first.traffic)
    return frame.astype(COLUMNS), digest(drawn)


def take(
    who: Mapping[Place, Entrant], groups: Mapping[str, list[BenchmarkScenario]]
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Drive groups of scenarios in processes; returns all episodes, and the digest of each group's scenarios.

    Raises:
        UserError: the policy cannot be made, or does not fit an environment; before anything else is driven.
    """
    asked = {group: (who[own[0].task, own[0].level], own) for group, own in groups.items()}
    for entrant, own in asked.values():
        if own[0].traffic == "regular":
            drive(entrant, own[:1])
    executor = LocalExecutor(cores())
    frames, digests = [], {}
    try:
        futures = {group: executor.submit(drive, *of) for group, of in asked.items()}
        for group, future in futures.items():
            frame, digests[group] = future.result()
            frames.append(frame)
            print(f"{len(frames)}/{len(groups)} groups of scenarios: {group}", flush=True)
    finally:
        executor.shutdown(cancel_futures=True)
    return pd.concat(frames), digests
