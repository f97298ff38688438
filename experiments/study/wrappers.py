"""What a task's training changes about its environment, by gymnasium's wrappers; the same in both arms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np

from agents.greedy import with_column
from agents.streams import stream
from experiments.study.arms import drawn_dose

Env = gym.Env[Any, Any]


class _Observed(gym.ObservationWrapper[Any, Any, Any]):
    """Adds a column to observations (vehicles, features): `share()` in the ego's row, 0 in the others."""

    def __init__(self, env: Env) -> None:
        super().__init__(env)
        space = env.observation_space
        if not isinstance(space, gym.spaces.Box) or len(space.shape) != 2:
            raise ValueError(f"Only observations (vehicles, features) can get a column more, not {space}.")
        low = np.column_stack([space.low, np.zeros(space.shape[0])]).astype(np.float32)
        high = np.column_stack([space.high, np.ones(space.shape[0])]).astype(np.float32)
        self.observation_space = gym.spaces.Box(low, high)

    def observation(self, observation: np.ndarray) -> np.ndarray:
        """The observation with its column."""
        return with_column(observation, self.share())

    def share(self) -> float:
        """A number from 0 to 1."""
        raise NotImplementedError


class DoseObserved(_Observed):
    """Shows the dose of risk of the traffic."""

    def share(self) -> float:
        """The dose."""
        return float(self.env.unwrapped.config["risk"])  # type: ignore[attr-defined]


class TimeObserved(_Observed, gym.utils.RecordConstructorArgs):
    """Shows the share of the episode that is over. ``steps``: length of an episode.

    gymnasium's TimeAwareObservation would flatten the table of vehicles.
    """

    def __init__(self, env: Env, steps: int) -> None:
        gym.utils.RecordConstructorArgs.__init__(self, steps=steps)  # so that its spec makes it again
        super().__init__(env)
        self.steps, self._time = steps, 0

    def reset(
        self, **kwargs: Any
    ) -> tuple[Any, dict[str, Any]]:  # the name that gymnasium's checker looks for
        """Begin an episode at time 0."""
        self._time = 0
        return super().reset(**kwargs)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Count the step."""
        self._time += 1
        return super().step(action)

    def share(self) -> float:
        """The share of the steps."""
        return min(self._time / self.steps, 1.0)


class TerminalLimit(gym.Wrapper[Any, Any, Any, Any]):
    """The time limit is an end like any other: nothing is expected beyond it."""

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, whose truncation counts as termination."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, reward, terminated or truncated, False, info


class TrainingClock(TerminalLimit):
    """Ends an episode after a whole number of seconds that is drawn from its seed, uniformly from first to last.

    The end is terminal, so that an agent cannot know when a test ends, which is shorter or of which it does not observe
    the time. The environment's own limit has to be ``last`` [s] or later.
    """

    def __init__(self, env: Env, first: int, last: int) -> None:
        super().__init__(env)
        if not 0 < first <= last:
            raise ValueError(
                f"A training clock runs from 1 s or more to no less, not from {first} to {last} s."
            )
        self._range, self._left = (first, last), 0

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode and draw its end. ValueError without a seed."""
        seconds = stream(_seed(options), "training clock").integers(*self._range, endpoint=True)
        self._left = _steps(self.env, int(seconds))
        return self.env.reset(**options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, which is the last one when the time is over."""
        self._left -= 1
        observation, reward, ended, truncated, info = super().step(action)
        return observation, reward, ended or self._left <= 0, truncated, info


class CrashReward(gym.Wrapper[Any, Any, Any, Any]):
    """Adds a reward for the step that ends in a crash, for tasks whose reward has no such term."""

    def __init__(self, env: Env, reward: float) -> None:
        super().__init__(env)
        self._reward = reward

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step with the crash in its reward."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, float(reward) + self._reward * info["crashed"], terminated, truncated, info


class DrawnDose(gym.Wrapper[Any, Any, Any, Any]):
    """Every episode has the dose of risk that `arms.drawn_dose` draws for this arm from the episode's seed."""

    def __init__(self, env: Env, arm: str) -> None:
        super().__init__(env)
        self._arm = arm

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in the traffic of its dose. ValueError without a seed."""
        others = options.get("options") or {}
        config = {**others.get("config", {}), "risk": drawn_dose(self._arm, _seed(options))}
        return self.env.reset(**{**options, "options": {**others, "config": config}})


def observed(env: Env, profile: Mapping[str, Any]) -> Env:
    """The environment as an agent of this profile observes it."""
    if profile.get("dose_observed"):
        env = DoseObserved(env)
    if profile.get("finite_horizon"):
        env = TimeObserved(env, _steps(env, env.unwrapped.config["duration"]))  # type: ignore[attr-defined]
    if seconds := profile.get("time_observed"):  # as a share of so many, in training and test alike
        env = TimeObserved(env, _steps(env, seconds))
    return env


def trained_on(env: Env, profile: Mapping[str, Any]) -> Env:
    """The environment as an agent of this profile is trained on it."""
    env = observed(env, profile)
    if crash := profile.get("crash_reward"):
        env = CrashReward(env, crash)
    if clock := profile.get("training_clock"):
        return TrainingClock(env, *clock)
    return TerminalLimit(env) if profile.get("finite_horizon") else env


def _steps(env: Env, seconds: float) -> int:
    return round(seconds * env.unwrapped.config.get("policy_frequency", 1))  # type: ignore[attr-defined]


def _seed(options: Mapping[str, Any]) -> int:
    """The seed among the arguments of reset."""
    if options.get("seed") is None:
        raise ValueError(
            "What is drawn for an episode is drawn from its seed: reset the environment with one."
        )
    return int(options["seed"])
