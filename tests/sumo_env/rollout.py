"""An episode as numbers, printed by its digest: ``python -m tests.sumo_env.rollout JSON``."""

from __future__ import annotations

import hashlib
import json
import sys
from typing import Any

import numpy as np

from sumo_env.env import DrivingEnv


def rollout(task: str, seed: int, config: dict[str, Any] | None = None) -> np.ndarray:
    """Observations, reward and ego state of one episode under pseudo-random actions, shape (steps + 1, values)."""
    env = DrivingEnv(task, config)
    rows = record(env, seed)
    env.close()
    return rows


def record(env: DrivingEnv, seed: int) -> np.ndarray:
    """As `rollout`, in a given environment."""
    actions = np.random.default_rng(seed + 1).integers(len(env.actions), size=100)
    observation, info = env.reset(seed=seed)
    rows, over, step = [], False, 0
    reward: float = 0.0
    while True:
        rows.append([*observation.ravel(), reward, info["speed"], info["density"], min(info["min_ttc"], 1e9)])
        if over:
            return np.array(rows)
        observation, reward, terminated, truncated, info = env.step(int(actions[step]))
        over = terminated or truncated
        step += 1


def digest(rows: np.ndarray) -> str:
    """A name for the exact bits."""
    return hashlib.sha256(rows.tobytes()).hexdigest()


if __name__ == "__main__":
    for task, seed, config in json.loads(sys.argv[1]):
        print(digest(rollout(task, seed, config)))
