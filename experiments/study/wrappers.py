"""What a task's training changes about its environment, by gymnasium's wrappers; the same in both arms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from agents.streams import stream
from experiments.study.arms import drawn_dose


class TimeObserved(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Adds a column to observations (vehicles, features): in the ego's row the share of the episode that is over.

    gymnasium's TimeAwareObservation would flatten the table of vehicles. ``steps``: length of an episode.
    """

    def __init__(self, env: gym.Env[Any, Any], steps: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, steps=steps)
        gym.ObservationWrapper.__init__(self, env)
        self.observation_space = _with_share(env.observation_space)
        self._steps, self._time = steps, 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode at time 0."""
        self._time = 0
        return super().reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Count the step."""
        self._time += 1
        return super().step(action)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """The observation with its column of time."""
        return _add_share(observation, min(self._time / self._steps, 1.0))


class DoseObserved(gym.ObservationWrapper[Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Adds a column to observations (vehicles, features): in the ego's row the dose of risk of the traffic."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.ObservationWrapper.__init__(self, env)
        self.observation_space = _with_share(env.observation_space)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """The observation with its column of the dose."""
        return _add_share(observation, float(self.env.unwrapped.config["risk"]))  # type: ignore[attr-defined]


class TerminalLimit(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """The time limit is an end like any other: nothing is expected beyond it."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, whose truncation counts as termination."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated or truncated, False, info


class TrainingClock(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Ends an episode after a whole number of seconds that is drawn from its seed, uniformly from first to last.

    The end is terminal and nobody observes the time, so that an agent cannot know when a test ends. The environment's
    own limit has to be ``last`` [s] or later.
    """

    def __init__(self, env: gym.Env[Any, Any], first: int, last: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, first=first, last=last)
        gym.Wrapper.__init__(self, env)
        if not 0 < first <= last:
            raise ValueError(
                f"A training clock runs from 1 s or more to no less, not from {first} to {last} s."
            )
        self._range, self._left = (first, last), 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode and draw its end. ValueError without a seed."""
        first, last = self._range
        seconds = stream(_given(seed), "training clock").integers(first, last, endpoint=True)
        self._left = round(seconds * self.env.unwrapped.config.get("policy_frequency", 1))  # type: ignore[attr-defined]
        return self.env.reset(seed=seed, options=options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, which is the last one when the time is over."""
        self._left -= 1
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated or truncated or self._left <= 0, False, info


class CrashReward(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Adds a reward for the step that ends in a crash, for tasks whose reward has no such term."""

    def __init__(self, env: gym.Env[Any, Any], reward: float) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, reward=reward)
        gym.Wrapper.__init__(self, env)
        self._reward = reward

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step with the crash in its reward."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward) + self._reward * info["crashed"], terminated, truncated, info


class DrawnDose(gym.Wrapper[Any, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """Every episode has the dose of risk that `arms.drawn_dose` draws for this arm from the episode's seed."""

    def __init__(self, env: gym.Env[Any, Any], arm: str) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, arm=arm)
        gym.Wrapper.__init__(self, env)
        self._arm = arm

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in the traffic of its dose. ValueError without a seed."""
        config = {**(options or {}).get("config", {}), "risk": drawn_dose(self._arm, _given(seed))}
        return self.env.reset(seed=seed, options={**(options or {}), "config": config})


def observed(env: gym.Env[Any, Any], profile: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """The environment as an agent of this profile observes it."""
    if profile.get("dose_observed"):
        env = DoseObserved(env)
    if not profile.get("finite_horizon"):
        return env
    config = env.unwrapped.config  # type: ignore[attr-defined]
    return TimeObserved(env, round(config["duration"] * config.get("policy_frequency", 1)))


def trained_on(env: gym.Env[Any, Any], profile: Mapping[str, Any]) -> gym.Env[Any, Any]:
    """The environment as an agent of this profile is trained on it."""
    env = observed(env, profile)
    if crash := profile.get("crash_reward"):
        env = CrashReward(env, crash)
    if clock := profile.get("training_clock"):
        env = TrainingClock(env, *clock)
    return TerminalLimit(env) if profile.get("finite_horizon") else env


def _with_share(space: gym.Space[Any]) -> gym.spaces.Box:
    """A space of observations (vehicles, features) with one more column, from 0 to 1."""
    if not isinstance(space, gym.spaces.Box) or len(space.shape) != 2:
        raise ValueError(f"Only observations (vehicles, features) can get a column more, not {space}.")
    low = np.column_stack([space.low, np.zeros(space.shape[0])]).astype(np.float32)
    high = np.column_stack([space.high, np.ones(space.shape[0])]).astype(np.float32)
    return gym.spaces.Box(low, high)


def _add_share(observation: np.ndarray, share: float) -> np.ndarray:
    """The observation with one more column: the share in the ego's row, 0 in the others."""
    column = np.zeros(len(observation), observation.dtype)
    column[0] = share
    return np.column_stack([observation, column])


def _given(seed: int | None) -> int:
    if seed is None:
        raise ValueError(
            "What is drawn for an episode is drawn from its seed: reset the environment with one."
        )
    return seed
