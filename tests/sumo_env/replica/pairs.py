"""Whole episodes of the replica beside highway-env itself, step by step."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from agents.rules import make_policy
from experiments.backends import make_env
from experiments.study.grid import BASELINES
from sumo_env.tasks import TASKS

POSES = 1e-6  # [m], [m/s], [rad] by which poses and speeds may differ
VALUES = 1e-5  # by which observations (32 bits), rewards and measures may differ


class Case(NamedTuple):
    """One episode; `level`: name of the task's traffic level, `ego`: of a policy in `agents.rules`, `law`: of risk."""

    task: str
    variant: str
    level: str
    risk: float
    ego: str
    seed: int
    law: str = "standard"


class Outcome(NamedTuple):
    """How an episode compares: greatest difference of poses and speeds, policy steps, and what else differed first."""

    worst: float
    steps: int
    difference: str

    @property
    def is_same(self) -> bool:
        return self.worst <= POSES and not self.difference


def cases(task: str, count: int, seed: int = 0) -> list[Case]:
    """This many episodes, spread evenly over variants, levels, doses of risk and egos."""
    joined = task not in ("highway", "two-way")  # the variants differ at the ends of lanes alone
    variants = ("path", "connected", "v0") if joined else ("path",)
    every = list(product(variants, TASKS[task].levels, (0.0, 1.0), BASELINES))
    order = np.random.default_rng(seed).permutation(len(every)).tolist()
    chosen = [every[order[k % len(every)]] for k in range(count)]
    return [Case(task, *case, 1000 * seed + k) for k, case in enumerate(chosen)]


def compare(case: Case) -> Outcome:
    """Drive one episode in both, by the same actions: those that the ego's policy takes in highway-env."""
    config = {
        **TASKS[case.task].levels[case.level],
        "risk": case.risk,
        "variant": case.variant,
        "risk_law": case.law,
    }
    stock: Any = make_env("highway-env", case.task, config)
    replica: Any = make_env("replica", case.task, config)
    policy = make_policy(case.ego, stock)
    policy.reset(case.seed)
    theirs, ours = stock.reset(seed=case.seed), replica.reset(seed=case.seed)
    worst, steps = 0.0, 0
    while True:
        worst = max(worst, distance(stock.unwrapped.scene, replica.unwrapped.scene))
        difference = first_difference(theirs, ours)
        if difference or worst > POSES or (steps and (theirs[2] or theirs[3])):
            return Outcome(worst, steps, difference)
        action = policy.act(theirs[0])
        theirs, ours = stock.step(action), replica.step(action)
        steps += 1


def distance(theirs: Any, ours: Any) -> float:
    """Greatest difference of positions, speeds and headings; inf if vehicles or wrecks are not the same."""
    if theirs.ids != ours.ids or not np.array_equal(theirs.crashed, ours.crashed) or theirs.time != ours.time:
        return np.inf
    return max(
        float(np.abs(getattr(theirs, name) - getattr(ours, name)).max())
        for name in ("x", "y", "speed", "heading")
    )


def first_difference(theirs: Any, ours: Any) -> str:
    """What `reset` or `step` returned differently: observation, reward, endings, or an entry of ``info``."""
    if not has_same_rows(theirs[0], ours[0]):
        return f"observation: {theirs[0]} and {ours[0]}"
    names = ("info",) if len(theirs) == 2 else ("reward", "terminated", "truncated", "info")
    a, b = (list(leaves("", dict(zip(names, result[1:], strict=True)))) for result in (theirs, ours))
    for (name, value), (other, own) in zip(a, b, strict=True):
        is_same = value == own if isinstance(value, str) else np.isclose(value, own, rtol=0.0, atol=VALUES)
        if name != other or not is_same:
            return f"{name}: {value} and {other}: {own}"
    return ""


def leaves(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The values in dictionaries of dictionaries, by the way to each."""
    if isinstance(value, dict):
        for key in sorted(value):
            yield from leaves(f"{name}/{key}", value[key])
    else:
        yield name, value


def has_same_rows(theirs: np.ndarray, ours: np.ndarray) -> bool:
    """Are two observations equal but for the order of their rows?

    Vehicles are sorted by their distance projected on the ego's lane. Those that stand one behind the other across that
    lane are equally far, up to rounding, and `sumo_env.observation` rounds by its own geometry.
    """
    left = list(ours)
    for row in theirs:
        same = [k for k, other in enumerate(left) if np.allclose(row, other, rtol=0.0, atol=VALUES)]
        if not same:
            return False
        left.pop(same[0])
    return True
