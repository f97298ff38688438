"""A toy road: one leader, four lanes, the meta-actions and nearly constant observations of the driving tasks."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch.nn import functional

from agents.models import Dueling

SPEEDS = (20.0, 25.0, 30.0)  # [m/s]


class Small(Dueling):
    """A network that learns in no time."""

    def __init__(self, space: gym.spaces.Box, actions: int) -> None:
        super().__init__(math.prod(space.shape), actions, (24, 16), (12,))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return super().forward(x.flatten(1))


class Noisy(Small):
    """Draws from torch's global generator, as many networks do."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return functional.dropout(super().forward(x), 0.3, self.training)


class Road(gym.Env[np.ndarray, np.int64]):
    """Drive behind a leader that keeps about 22 m/s; contact in its lane is a crash. 20 steps.

    Config "noise": standard deviation of the leader's way in a step [m]. ``seeds`` records every reset.
    """

    def __init__(self) -> None:
        self.observation_space = gym.spaces.Box(-1, 1, (2, 5), np.float32)
        self.action_space = gym.spaces.Discrete(5)
        self.noise = 1.0
        self.seeds: list[int | None] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None):
        super().reset(seed=seed)
        self.seeds.append(seed)
        self.noise = (options or {}).get("config", {}).get("noise", 1.0)
        self.gap = self.np_random.uniform(20, 60)
        self.y = 4.0 * self.np_random.integers(4)
        self.speed, self.rung, self.time = 25.0, 1, 0
        return self._observation(), {}

    def step(self, action: int):
        self.rung = int(np.clip(self.rung + {3: 1, 4: -1}.get(int(action), 0), 0, 2))
        self.y = float(np.clip(self.y + {0: -4, 2: 4}.get(int(action), 0), 0, 12))
        self.speed += 0.8 * (SPEEDS[self.rung] - self.speed)
        self.gap += 22 - self.speed + self.noise * self.np_random.normal()
        self.time += 1
        crashed = self.gap < 5 and self.y == 4
        reward = 0.0 if crashed else 0.67 + 0.02 * (self.speed - 20)
        info = {"speed": self.speed, "crashed": crashed}
        return self._observation(), reward, crashed, self.time >= 20, info

    def _observation(self) -> np.ndarray:
        ego = [1, 1, self.y / 16, self.speed / 80, 0]
        leader = [1, min(self.gap / 200, 1), (4 - self.y) / 16, (22 - self.speed) / 80, 0]
        return np.array([ego, leader], np.float32)
