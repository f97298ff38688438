"""What a task's training changes about its environment, by gymnasium's wrappers; the same in both arms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from agents.greedy import with_column
from experiments.study.arms import DRAWN, drawn_dose

Env = gym.Env[Any, Any]


class Observed(gym.ObservationWrapper[Any, Any, Any]):
    """Adds a column to observations (vehicles, features): a number from 0 to 1 in the ego's row, 0 in the others.

    ``share``: returns that number, after every reset and step.
    """

    def __init__(self, env: Env, share: Callable[[], float]) -> None:
        super().__init__(env)
        self._share = share
        space = env.observation_space
        if not isinstance(space, gym.spaces.Box) or len(space.shape) != 2:
            raise ValueError(f"Only observations (vehicles, features) can get a column more, not {space}.")
        low = np.column_stack([space.low, np.zeros(space.shape[0])]).astype(np.float32)
        high = np.column_stack([space.high, np.ones(space.shape[0])]).astype(np.float32)
        self.observation_space = gym.spaces.Box(low, high)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """The observation with its column."""
        return with_column(observation, self._share())


class TimeObserved(Observed):
    """Shows the share of the episode that is over. ``steps``: length of an episode.

    gymnasium's TimeAwareObservation would flatten the table of vehicles.
    """

    def __init__(self, env: Env, steps: int) -> None:
        super().__init__(env, lambda: min(self._time / steps, 1.0))
        self.steps, self._time = steps, 0

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin an episode at time 0."""
        self._time = 0
        return super().reset(**kwargs)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Count the step."""
        self._time += 1
        return super().step(action)


class Training(gym.Wrapper[Any, Any, Any, Any]):
    """An environment as an arm is trained on it.

    In arms.DRAWN every episode has the dose of risk that `arms.drawn_dose` draws from its seed. The profile may add a
    reward for crashes (`crash_reward`), and make the time limit an end like any other, beyond which nothing is expected
    (`finite_horizon`, `training_clock`).
    """

    def __init__(self, env: Env, profile: Mapping[str, Any], arm: str | None = None) -> None:
        super().__init__(env)
        self._drawn = arm if arm in DRAWN else None
        self._crash = float(profile.get("crash_reward", 0.0))
        self._terminal = bool(profile.get("finite_horizon") or profile.get("training_clock"))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode. ValueError without the seed that a dose is drawn from."""
        if self._drawn:
            if seed is None:
                raise ValueError(
                    "The dose of an episode is drawn from its seed: reset the environment with one."
                )
            others = options or {}
            config = {**others.get("config", {}), "risk": drawn_dose(self._drawn, seed)}
            options = {**others, "config": config}
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, with the crash in its reward; at a terminal limit its truncation counts as termination."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._terminal:
            terminated, truncated = terminated or truncated, False
        return observation, float(reward) + self._crash * info["crashed"], terminated, truncated, info


def observed(env: Env, profile: Mapping[str, Any]) -> Env:
    """The environment as an agent of this profile observes it."""
    inner: Any = env.unwrapped
    if profile.get("dose_observed"):
        env = Observed(env, lambda: float(inner.config["risk"]))
    # as a share of the episode, or of so many seconds in training and test alike
    seconds = inner.config["duration"] if profile.get("finite_horizon") else profile.get("time_observed")
    return TimeObserved(env, round(seconds * inner.config.get("policy_frequency", 1))) if seconds else env
