"""Policies that do not look: the same actions always, any action, or none because SUMO drives."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from agents.streams import stream


class Constant:
    """The same action at every step, or the same few over and over."""

    def __init__(self, *actions: int) -> None:
        self._actions, self._step = actions, 0

    def act(self, observation: np.ndarray) -> int:
        """The next action, whatever is observed."""
        self._step += 1
        return self._actions[(self._step - 1) % len(self._actions)]

    def reset(self, seed: int | None = None) -> None:
        """Begin with the first action."""
        self._step = 0


class Random:
    """Every action with equal probability."""

    def __init__(self, actions: int) -> None:
        self.actions = actions
        self.reset(0)

    def act(self, observation: np.ndarray) -> int:
        """An action, whatever is observed."""
        return int(self._generator.integers(self.actions))

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode; without a seed the draws go on where they are."""
        if seed is not None:
            self._generator = stream(seed, "random policy")


class BySumo:
    """SUMO's own driver, to whom the car is handed over (`sumo_env.env.DrivingEnv.hand_over`).

    Its actions are IDLE, and say nothing of what it does.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        inner: Any = env.unwrapped
        self._env = inner
        [self._idle] = [action for action, name in inner.actions.items() if name == "IDLE"]

    def act(self, observation: np.ndarray) -> int:
        """Hand the car over, which the environment takes back at every reset."""
        self._env.hand_over()
        return int(self._idle)

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do: it has no state."""
