"""A column more in an observation: a number that the agent is told beside what it sees."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np

Env = gym.Env[Any, Any]


def with_column(observation: np.ndarray, value: float) -> np.ndarray:
    """A table (vehicles, features) with a feature more: `value` in the ego's row, the first, 0 in the others."""
    column = np.zeros(len(observation), observation.dtype)
    column[0] = value
    return np.column_stack([observation, column])


class Observed(gym.ObservationWrapper[Any, Any, Any]):
    """Adds a column to observations (vehicles, features): a number from 0 to 1 in the ego's row, 0 in the others.

    ``share``: returns that number for an observation, after every reset and step.
    """

    def __init__(self, env: Env, share: Callable[[np.ndarray], float]) -> None:
        super().__init__(env)
        self._share = share
        space = env.observation_space
        if not isinstance(space, gym.spaces.Box) or len(space.shape) != 2:
            raise ValueError(f"Only observations (vehicles, features) can get a column more, not {space}.")
        low = np.column_stack([space.low, np.zeros(space.shape[0])]).astype(np.float32)
        high = np.column_stack([space.high, np.ones(space.shape[0])]).astype(np.float32)
        self.observation_space = gym.spaces.Box(low, high)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """The observation with its column."""
        return with_column(observation, self._share(observation))
