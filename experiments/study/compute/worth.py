"""Do an agent's values come true? What it expects when an episode begins, beside what it then gets."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from experiments.study.design.training_rules import TrainingRules


class Worth(gym.Wrapper[Any, Any, Any, Any]):
    """Notes, for each whole episode, the value of its first observation and the discounted sum of its rewards.

    Rewards are those of the training. At the time limit the value of the last observation is added, as in the
    learner's goals.

    Args:
        agent: that drives, a policy with Q-values. gamma: its discount.
    """

    def __init__(self, env: gym.Env[Any, Any], agent: Any, gamma: float, rules: TrainingRules) -> None:
        super().__init__(env)
        self._agent, self._gamma, self._rules = agent, gamma, rules
        self._rows: list[tuple[float, float]] = []

    def _value(self, observation: np.ndarray) -> float:
        return float(self._agent.q(observation).max())

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin an episode."""
        observation, info = self.env.reset(**options)
        self._expected, self._got, self._discount = self._value(observation), 0.0, 1.0
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Add the reward."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._got += self._discount * (float(reward) + self._rules.crash_reward * info["crashed"])
        self._discount *= self._gamma
        if truncated and not terminated:
            self._got += self._discount * self._value(observation)
        if terminated or truncated:
            self._rows.append((self._expected, self._got))
        return observation, reward, terminated, truncated, info

    def record(self) -> dict[str, Any]:
        """Of the episodes so far: their number, the means of what was expected and got, and the latter's size.

        Which is the root of the mean of its square.
        """
        expected, got = np.array(self._rows, float).T
        return {
            "episodes": len(self._rows),
            "expected": float(expected.mean()),
            "got": float(got.mean()),
            "size": float(np.sqrt(np.square(got).mean())),
        }
