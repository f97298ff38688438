"""Drivers that do not learn: the marks that a trained agent is held against."""

from __future__ import annotations

from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from agents.careful import Careful
from agents.idm import IDM
from agents.streams import stream

POLICIES = ("idle", "random", "faster", "slower", "idm", "careful")


class Policy(Protocol):
    """Anything that drives: learnt or not."""

    def act(self, observation: np.ndarray) -> int:
        """The action for an observation."""
        ...

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode; the seed fixes the policy's own random draws."""
        ...


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


def make_policy(name: str, env: gym.Env[Any, Any]) -> Policy:
    """The driver of this name for ``env``, whose ``unwrapped.actions`` maps action numbers to names.

    "idle", "faster" and "slower" repeat one meta-action, "random" draws uniformly, "idm" is :class:`agents.idm.IDM`,
    "careful" :class:`agents.careful.Careful`. Raises ValueError for an unknown name or an action that the environment
    lacks.
    """
    actions: dict[int, str] = env.unwrapped.actions  # type: ignore[attr-defined]
    if name == "random":
        return Random(len(actions))
    if name == "idm":
        return IDM(env)
    if name == "careful":
        return Careful(env)
    if name not in POLICIES:
        raise ValueError(f"Unknown policy {name!r}: choose one of {', '.join(POLICIES)}.")
    for number, action in actions.items():
        if action == name.upper():
            return Constant(number)
    raise ValueError(
        f"The policy {name!r} needs the action {name.upper()}; there are {', '.join(actions.values())}."
    )
