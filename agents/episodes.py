"""What is written down about the episodes of a training, whoever learns."""

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

# One row a training episode. step: environment steps of the training after the episode; return: undiscounted.
COLUMNS = {
    "episode": np.int64,
    "step": np.int64,
    "return": np.float64,
    "length": np.int64,
    "crashed": np.bool_,
}


class Episodes(gym.Wrapper[Any, Any, Any, Any]):
    """Writes down the episodes of an environment.

    Args:
        progress: called with environment steps after each episode.
    """

    def __init__(self, env: gym.Env[Any, Any], progress: Callable[[int], None] = lambda _: None) -> None:
        super().__init__(env)
        self._progress = progress
        self.rows: dict[str, list[Any]] = {name: [] for name in COLUMNS}  # values, episode by episode
        self.steps = 0  # of the environment so far

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin an episode."""
        self._rewards: list[float] = []
        return self.env.reset(**options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step; the last one of an episode completes its row."""
        observation, reward, terminated, truncated, info = self.env.step(int(action))
        self.steps += 1
        if not math.isfinite(reward):
            raise ValueError(f"the reward of training step {self.steps} is {reward}, not a finite number")
        self._rewards.append(float(reward))
        if terminated or truncated:
            row = {
                "episode": len(self.rows["episode"]),
                "step": self.steps,
                "return": sum(self._rewards),
                "length": len(self._rewards),
                "crashed": bool(info.get("crashed", False)),
            }
            for name, value in row.items():
                self.rows[name].append(value)
            self._progress(self.steps)
        return observation, reward, terminated, truncated, info

    def columns(self) -> dict[str, np.ndarray]:
        """The rows as an array for each column."""
        return {name: np.array(self.rows[name], dtype) for name, dtype in COLUMNS.items()}
