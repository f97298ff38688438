"""Uniform replay memory (Mnih et al. 2015), in preallocated arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class Batch(NamedTuple):
    """Transitions as tensors: observations (n, ...), the others (n,)."""

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    next_observations: Tensor
    terminated: Tensor


class Replay:
    """The last ``capacity`` transitions (s, a, r, s', terminated); an observation has the shape ``shape``.

    ``terminated`` is stored, not "done": an episode cut by its time limit goes on in the values (bootstrap), one ended
    by a crash does not.
    """

    def __init__(self, capacity: int, shape: tuple[int, ...]) -> None:
        self.capacity = capacity
        self.added = 0  # transitions ever added; the newest lies at (added - 1) % capacity
        self.least = self.most = 0.0  # of all rewards ever added, and of none
        # Memory is taken when it is first written, so a short training does not pay for the capacity.
        self.arrays: dict[str, np.ndarray] = {
            "observations": np.empty((capacity, *shape), np.float32),
            "actions": np.empty(capacity, np.int64),
            "rewards": np.empty(capacity, np.float32),
            "next_observations": np.empty((capacity, *shape), np.float32),
            "terminated": np.empty(capacity, np.float32),
        }

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
        """Store one transition, in place of the oldest one when full."""
        row = self.added % self.capacity
        transition = (observation, action, reward, next_observation, terminated)
        for array, value in zip(self.arrays.values(), transition, strict=True):
            array[row] = value
        self.added += 1
        self.least, self.most = min(self.least, reward), max(self.most, reward)

    def sample(self, generator: np.random.Generator, count: int, device: str = "cpu") -> Batch:
        """``count`` transitions, uniform with replacement."""
        rows = generator.integers(len(self), size=count)
        return Batch(*(torch.from_numpy(array[rows]).to(device) for array in self.arrays.values()))

    def first(self, count: int) -> np.ndarray:
        """The first observations that it holds, at most so many (a copy)."""
        return self.arrays["observations"][: min(count, len(self))].copy()
