"""Uniform replay memory (Mnih et al. 2015) of n-step transitions, in preallocated arrays."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class Step(NamedTuple):
    """A step of an episode; is_random: whether its action was drawn, and not the greedy one."""

    observation: np.ndarray
    action: int
    reward: float
    next_observation: np.ndarray
    terminated: bool
    is_random: bool = False


class Transition(NamedTuple):
    """What a goal of Q(observation, action) is made of: the reward, and the value of the next observation.

    reward: discounted sum of those of one step or several. discount: of the value, 0 after the end of an episode. left:
    steps from the observation to the time limit, infinite where there is none.
    """

    observation: np.ndarray
    action: int
    reward: float
    next_observation: np.ndarray
    discount: float
    left: float


class Batch(NamedTuple):
    """Transitions as tensors: observations (n, ...), the others (n,)."""

    observations: Tensor
    actions: Tensor
    rewards: Tensor
    next_observations: Tensor
    discounts: Tensor
    left: Tensor


def transitions(
    episode: Sequence[Step], gamma: float, n_steps: int = 1, horizon: float = math.inf
) -> Iterator[Transition]:
    """A transition from every step of an episode, over `n_steps` steps or until the next random action (Watkins 1989).

    An episode cut by its time limit goes on in the values (bootstrap), one ended by a crash does not.
    horizon: steps after which every episode is terminated.
    """
    for start, first in enumerate(episode):
        reward, discount, last = 0.0, 1.0, first
        for step in episode[start : start + n_steps]:
            if step.is_random and step is not first:
                break
            reward, discount, last = reward + discount * step.reward, discount * gamma, step
        discount *= not last.terminated
        yield Transition(
            first.observation, first.action, reward, last.next_observation, discount, horizon - start
        )


class Replay:
    """The last ``capacity`` transitions; an observation has the shape ``shape``."""

    def __init__(self, capacity: int, shape: tuple[int, ...]) -> None:
        self.capacity = capacity
        self.added = 0  # transitions ever added; the newest lies at (added - 1) % capacity
        # Memory is taken when it is first written, so a short training does not pay for the capacity.
        self.arrays: dict[str, np.ndarray] = {
            "observations": np.empty((capacity, *shape), np.float32),
            "actions": np.empty(capacity, np.int64),
            "rewards": np.empty(capacity, np.float32),
            "next_observations": np.empty((capacity, *shape), np.float32),
            "discounts": np.empty(capacity, np.float32),
            "left": np.empty(capacity, np.float64),
        }

    def __len__(self) -> int:
        return min(self.added, self.capacity)

    def add(self, transition: Transition) -> None:
        """Store one transition, in place of the oldest one when full."""
        row = self.added % self.capacity
        for array, value in zip(self.arrays.values(), transition, strict=True):
            array[row] = value
        self.added += 1

    def sample(self, generator: np.random.Generator, count: int, device: str = "cpu") -> Batch:
        """``count`` transitions, uniform with replacement."""
        rows = generator.integers(len(self), size=count)
        return Batch(*(torch.from_numpy(array[rows]).to(device) for array in self.arrays.values()))

    def first(self, count: int) -> np.ndarray:
        """The first observations that it holds, at most so many (a copy)."""
        return self.arrays["observations"][: min(count, len(self))].copy()
