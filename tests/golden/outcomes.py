"""How whole episodes end, as statistics over seeds: what a change of behaviour moves and rounding does not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.rules import make_policy
from sumo_env.scene import is_obstacle
from tests.golden.scenes import cells, make

EGOS = ("idle", "random", "idm")
SEEDS = range(1000, 1040)
# What a mean over the 40 seeds may differ by, if two standard errors of the golden mean are less.
FLOOR = {"crash_rate": 0.05, "return": 0.2, "length": 0.2, "traffic_speed": 0.1}


def drive(task: str, level: str, risk: float) -> dict[str, Any]:
    """One cell: ego -> measure -> mean and its standard error over the seeds.

    The measures are crash_rate, return, length [policy steps] and traffic_speed (of the other vehicles over the
    steps of the episode [m/s]).
    """
    env = make(task, level, risk)
    result = {}
    for ego in EGOS:
        rows = pd.DataFrame([episode(env, ego, seed) for seed in SEEDS], columns=list(FLOOR))
        result[ego] = rows.agg(["mean", "sem"]).round(4).to_dict("list")
    env.close()
    return result


def episode(env: gym.Env[Any, Any], ego: str, seed: int) -> tuple[float, float, float, float]:
    """Crashed or not, return, length and mean traffic speed of one episode."""
    inner: Any = env.unwrapped
    policy = make_policy(ego, env)
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    total, length, over = 0.0, 0, False
    speeds: list[float] = []
    info: dict[str, Any] = {}
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        total, length, over = total + float(reward), length + 1, terminated or truncated
        scene = inner.scene
        speeds += [
            scene.speed.item(row) for row in range(1, len(scene.ids)) if not is_obstacle(scene.ids[row])
        ]
    return float(info["crashed"]), total, float(length), float(np.mean(speeds))


def table(task: str) -> dict[str, Any]:
    """All cells of a task."""
    return {f"level {level}, risk {risk:g}": drive(task, level, risk) for level, risk in cells(task)}


def differences(now: Mapping[str, Any], then: Mapping[str, Any]) -> list[str]:
    """Every mean of a cell that is too far from the golden one.

    Both drive the same seeds. Where behaviour is unchanged, only episodes that rounding sends another way differ:
    with a tenth of them, two standard errors are exceeded about once in 100,000 comparisons.
    """
    found = []
    for ego in EGOS:
        for name, floor in FLOOR.items():
            (mean, _), (golden, error) = now[ego][name], then[ego][name]
            if abs(mean - golden) > max(2 * error, floor):
                found.append(f"{ego}, {name}: {mean}, golden {golden} with a standard error of {error}")
    return found
