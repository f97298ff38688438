"""SUMO drives the ego where a rule says so, and the agent elsewhere."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym


class HandOver(gym.Wrapper[Any, Any, Any, Any]):
    """Before each step, hands the ego to SUMO or takes it back (`DrivingEnv.hand_over`).

    >>> env = HandOver(env, lambda env: env.scene.place.lane[0] != "approach:from")

    Actions have no effect while SUMO drives.

    Args:
        env: on SUMO.
        where: of ``env.unwrapped``, whether SUMO drives the next step.
    """

    def __init__(self, env: gym.Env[Any, Any], where: Callable[[Any], bool]) -> None:
        super().__init__(env)
        self.where = where

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive one policy step."""
        inner: Any = self.env.unwrapped
        inner.hand_over(self.where(inner))
        return self.env.step(action)
