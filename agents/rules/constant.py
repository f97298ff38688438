"""Policies that do not look: the same action always, or any action."""

from __future__ import annotations

import numpy as np

from agents.streams import stream


class Constant:
    """The same action at every step."""

    def __init__(self, action: int) -> None:
        self.action = action

    def act(self, observation: np.ndarray) -> int:
        """The action, whatever is observed."""
        return self.action

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do."""


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
