"""Networks that learn in no time."""

import math
from typing import Any

import gymnasium as gym
import torch
from torch.nn import functional

from agents.models import Dueling, DuelingMLP


def weights(policy: Any) -> bytes:
    """Those of a policy's network."""
    return b"".join(value.numpy().tobytes() for value in policy.network.state_dict().values())


class Small(DuelingMLP):
    """The paper's network with fewer and smaller layers."""

    def __init__(
        self, space: gym.spaces.Box, actions: int, hidden: tuple[int, ...] = (24, 16), stream: int = 12
    ) -> None:
        Dueling.__init__(self, math.prod(space.shape), actions, hidden, (stream,))


class Noisy(Small):
    """Draws from torch's global generator, as many networks do."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return functional.dropout(super().forward(x), 0.3, self.training)
