"""Uniform replay memory of one agent (Mnih et al. 2015), in preallocated arrays."""

from __future__ import annotations

import numpy as np


class Replay:
    """The last ``capacity`` transitions (s, a, r, s', terminated); an observation is ``inputs`` numbers.

    ``terminated`` is stored, not "done": an episode cut by its time limit goes on in the values (bootstrap),
    one ended by a crash does not.
    """

    def __init__(self, capacity: int, inputs: int) -> None:
        if capacity < 1:
            raise ValueError(f"The replay needs a capacity of at least 1, got {capacity}.")
        self.capacity = capacity
        self.added = 0  # transitions ever added; the newest lies at (added - 1) % capacity
        # Untouched pages cost no memory, so a short run does not pay for the capacity. Zeros, because next
        # observations are evaluated in blocks that need not be full.
        self.observations = np.zeros((capacity, inputs), dtype=np.float32)
        self.next_observations = np.zeros((capacity, inputs), dtype=np.float32)
        self.actions = np.empty(capacity, dtype=np.int64)
        self.rewards = np.empty(capacity, dtype=np.float32)
        self.terminated = np.empty(capacity, dtype=np.float32)

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(
        self,
        observation: np.ndarray,
        action: int,
        reward: float,
        next_observation: np.ndarray,
        terminated: bool,
    ) -> None:
        """Store one transition, in place of the oldest one when full. Observations may have any shape."""
        row = self.added % self.capacity
        self.observations[row] = np.reshape(observation, -1)
        self.next_observations[row] = np.reshape(next_observation, -1)
        self.actions[row] = action
        self.rewards[row] = reward
        self.terminated[row] = terminated
        self.added += 1

    def sample(self, generator: np.random.Generator, count: int) -> np.ndarray:
        """Rows of ``count`` transitions, uniform with replacement. Raises ValueError on an empty replay."""
        if self.added == 0:
            raise ValueError("Cannot sample from an empty replay: add transitions first.")
        return generator.integers(len(self), size=count)

    def state_dict(self) -> dict[str, np.ndarray]:
        """The filled part of every array (views of live memory), and the number of additions."""
        filled = slice(len(self))
        return {
            "observations": self.observations[filled],
            "next_observations": self.next_observations[filled],
            "actions": self.actions[filled],
            "rewards": self.rewards[filled],
            "terminated": self.terminated[filled],
            "added": np.array(self.added),
        }

    def load_state_dict(self, state: dict[str, np.ndarray]) -> None:
        """Put back a state. Raises ValueError when it belongs to another capacity or observation size."""
        added = int(state["added"])
        filled = min(added, self.capacity)
        for name in ("observations", "next_observations", "actions", "rewards", "terminated"):
            target = getattr(self, name)
            expected = (filled, *target.shape[1:])
            if state[name].shape != expected:
                raise ValueError(f"Expected replay {name} of shape {expected}, got {state[name].shape}.")
            target[:filled] = state[name]
        self.added = added
