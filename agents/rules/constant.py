"""Policies that do not look: the same actions always, or any action."""

from __future__ import annotations

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
