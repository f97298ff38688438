"""What a training, or unseen traffic, changes about an environment, by gymnasium's wrappers."""

from typing import Any

import gymnasium as gym

from agents.extra_column import Env, Observed
from agents.streams import episode_seed
from experiments.study.design.traffic import Traffic
from experiments.study.design.training_rules import TrainingRules
from sumo_env.traffic.scenario import Scenario


class TimeObserved(Observed):
    """Shows the share of the episode that is over. ``steps``: length of an episode.

    gymnasium's TimeAwareObservation would flatten the table of vehicles.
    """

    def __init__(self, env: Env, steps: int) -> None:
        super().__init__(env, lambda _: min(self._time / steps, 1.0))
        self.steps, self._time = steps, 0

    def reset(self, **kwargs: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin an episode at time 0."""
        self._time = 0
        return super().reset(**kwargs)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Count the step."""
        self._time += 1
        return super().step(action)


class TrainingEnv(gym.Wrapper[Any, Any, Any, Any]):
    """An environment as an arm is trained on it: the arm's traffic, and the rules of the training.

    A reset without a seed begins the training's next episode, so that every learner meets the same scenarios in the
    same order. Of several environments of a training, each has every `count`-th episode, from `first` on.

    seed: of the training.
    """

    def __init__(
        self, env: Env, rules: TrainingRules, traffic: Traffic, seed: int, first: int = 0, count: int = 1
    ) -> None:
        super().__init__(env)
        self._rules, self._traffic, self._seed = rules, traffic, seed
        self._episode, self._count = first, count

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; its dose of risk is the arm's, or drawn from its seed."""
        if seed is None:
            seed = episode_seed(self._seed, self._episode)
            self._episode += self._count
        own, others = self._traffic.options(seed), options or {}
        config = {**others.get("config", {}), **own["config"]}
        return self.env.reset(seed=seed, options={**others, **own, "config": config})

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step, with the crash in its reward; at a terminal limit its truncation counts as termination."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._rules.training_clock:  # its end is no truncation: no bootstrapping
            terminated, truncated = terminated or truncated, False
        reward = float(reward) + self._rules.crash_reward * info["crashed"]
        return observation, reward, terminated, truncated, info


def observed(env: Env, rules: TrainingRules) -> Env:
    """The environment as an agent that was trained by these rules observes it."""
    inner: Any = env.unwrapped
    if rules.dose_observed:
        env = Observed(env, lambda _: float(inner.config["risk"]))
    if rules.time_observed is None:
        return env
    return TimeObserved(env, round(rules.time_observed * inner.config.get("policy_frequency", 1)))


class UnseenRisk(gym.Wrapper[Any, Any, Any, Any]):
    """An environment whose episodes have unseen traffic, whatever dose of risk `reset` asks for."""

    def __init__(self, env: gym.Env[Any, Any], traffic: Traffic) -> None:
        super().__init__(env)
        self._traffic = traffic

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode: draw the scenario of the seed in regular and in risky traffic, and mix the two."""
        drawn: list[Scenario] = []
        for risk in (0.0, 1.0):
            self.env.reset(seed=seed, options={"config": {"risk": risk}})
            drawn.append(self.env.unwrapped.scenario)  # type: ignore[attr-defined]
        return self.env.reset(seed=seed, options={"scenario": self._traffic.scenario(*drawn)})
