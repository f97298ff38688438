"""The test of a policy: the same regular and risky scenarios for every arm, training seed and policy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.policies import Policy
from experiments.study.compute.wrappers import UnseenRisk
from experiments.study.design.arms import scenario_seed, stream_seed
from experiments.study.design.traffic import TRAFFICS, traffic_named

STOPPED = 1.0  # [m/s] an ego slower than this stands
ACTIONS = 5
# Columns of episodes.parquet and their types, one row a test episode.
COLUMNS: dict[str, str] = {
    "traffic": "str",  # "regular", "risky", or another of `traffic.ALL`
    "scenario": "int64",  # number of the scenario, the same seed in both traffics
    "return": "float64",  # undiscounted sum of rewards
    "length": "int64",  # policy steps
    "crashed": "bool",
    "arrived": "bool",
    "truncated": "bool",  # the time limit ended it
    "mean_speed": "float64",  # [m/s], mean over the steps
    "distance": "float64",  # [m]
    "min_ttc": "float64",  # [s] smallest time-to-collision, inf if there was none
    "near_misses": "int64",  # steps with a time-to-collision below 1.5 s and no crash
    "density": "float64",  # other vehicles within 200 m, mean over the steps
    "stopped": "float64",  # share of the steps with less than 1 m/s
    **{f"action_{number}": "int64" for number in range(ACTIONS)},  # how often each action was chosen
    "crash_time": "float64",  # [s] since the start; this and the following are missing without a crash
    "crash_other": "str",
    "crash_x": "float64",  # [m] the ego's centre
    "crash_y": "float64",
    "crash_relative_x": "float64",  # [m] the other's centre in the ego's frame
    "crash_relative_y": "float64",
    "crash_relative_heading": "float64",  # [rad]
    "crash_closing_speed": "float64",  # [m/s]
    "crash_type": "str",
    "crash_detected_by": "str",
    "actions": "str",  # the actions one after the other, a digit each; cells of earlier versions lack them
}
CRASH_KEYS = tuple(name.removeprefix("crash_") for name in COLUMNS if name.startswith("crash_"))


def play(
    env: gym.Env[Any, Any],
    policy: Policy,
    task: str,
    level: int,
    traffic: str,
    scenario: int,
    on_step: Callable[[], None] | None = None,
    purpose: str = "test",
    options: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Play one test episode and return its row of COLUMNS.

    Args:
        env: an environment of this task and level.
        traffic: of `traffic.ALL`.
        scenario: number of the test scenario.
        on_step: called after the reset and after every step (a recorder).
        purpose: what the scenario is for, "test" or "gate".
        options: of the reset, beside the dose of risk.
    """
    named = traffic_named(traffic)
    if named.is_unseen:
        env = UnseenRisk(env, named)
    policy.reset(stream_seed("policy", task, level, traffic, scenario))
    seed = scenario_seed(task, level, scenario, purpose)
    observation, info = env.reset(
        seed=seed, options={"config": {"risk": named.dose_of(seed)}, **(options or {})}
    )
    if on_step:
        on_step()
    rewards: list[float] = []
    steps: list[dict[str, Any]] = []
    actions: list[int] = []
    terminated = truncated = False
    while not (terminated or truncated):
        action = policy.act(observation)
        observation, reward, terminated, truncated, info = env.step(action)
        rewards.append(float(reward))
        steps.append(info)
        actions.append(int(action))
        if on_step:
            on_step()
    speeds = np.array([step["speed"] for step in steps])
    crash = info["crash"] if info["crashed"] else {}
    return {
        "traffic": traffic,
        "scenario": scenario,
        "return": math.fsum(rewards),
        "length": len(rewards),
        "crashed": bool(info["crashed"]),
        "arrived": bool(info["arrived"]),
        "truncated": bool(truncated and not terminated),
        "mean_speed": float(speeds.mean()),
        "distance": math.fsum(step["distance"] for step in steps),
        "min_ttc": min(float(step["min_ttc_before_contact"]) for step in steps),
        "near_misses": sum(bool(step["near_miss"]) for step in steps),
        "density": float(np.mean([step["density"] for step in steps])),
        "stopped": float((speeds < STOPPED).mean()),
        **{f"action_{number}": actions.count(number) for number in range(ACTIONS)},
        **{f"crash_{key}": crash.get(key) for key in CRASH_KEYS},
        "actions": "".join(map(str, actions)),
    }


def evaluate(
    env: gym.Env[Any, Any],
    policy: Policy,
    task: str,
    level: int,
    episodes: int,
    on_episode: Callable[[], None] | None = None,
    purpose: str = "test",
    traffics: Sequence[str] = tuple(TRAFFICS),
    first: int = 0,
) -> pd.DataFrame:
    """Test a policy on `episodes` scenarios, from number `first` on, in each of the traffics; one row of COLUMNS each.

    The result depends on the arguments alone, not on what `env` did before.
    """
    rows = []
    for traffic in traffics:
        for scenario in range(first, first + episodes):
            rows.append(play(env, policy, task, level, traffic, scenario, purpose=purpose))
            if on_episode:
                on_episode()
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype(COLUMNS)
