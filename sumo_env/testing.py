"""A check of a task of one's own: ``check_task(Platoon())`` before training on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium.utils.env_checker import check_env

from sumo_env.env import DrivingEnv
from sumo_env.tasks.base import Task


def check_task(task: Task, config: Mapping[str, Any] | None = None, seeds: int = 3) -> None:
    """Drive episodes of a task, and see that they are what gymnasium and a study rely on.

    Raises:
        AssertionError: a term of the reward has no weight in the configuration, a reward is no finite number, or the
            same seed gives two different episodes. Errors of the task itself are raised with a note of the method.
    """
    name = type(task).__name__
    env = DrivingEnv(task, config)
    try:
        check_env(env, skip_render_check=True)
        for seed in range(seeds):
            first, again = _episode(env, seed), _episode(env, seed)
            assert len(first) == len(again) and np.array_equal(first, again), (
                f"{name}: seed {seed} gave two different episodes; draw all from rng, drivers or stream(seed, ...)"
            )
            assert np.isfinite(first).all(), f"{name}: a reward of seed {seed} is no finite number"
        if type(task).reward is Task.reward or "weighted" in type(task).reward.__code__.co_names:
            for term in env._rewards(1):
                known = term in env.config or term == "on_road_reward"
                assert known, f"{name}.rewards has the term {term!r}, which has no weight in {name}.defaults"
    finally:
        env.close()


def _episode(env: DrivingEnv, seed: int) -> list[float]:
    """The rewards of an episode of random actions."""
    env.reset(seed=seed)
    env.action_space.seed(seed)
    rewards, over = [], False
    while not over:
        _, reward, terminated, truncated, _ = env.step(int(env.action_space.sample()))
        rewards.append(reward)
        over = terminated or truncated
    return rewards
