"""Policies: what a study can test, whether it learnt here, learnt elsewhere or never learnt.

Learnt here: :class:`agents.greedy.Greedy`. Learnt elsewhere: :class:`StableBaselines`, and any object of a user's file.
Never learnt: `agents.rules`.
"""

from __future__ import annotations

import inspect
import json
import zipfile
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from agents.plugins import load_object


class Policy(Protocol):
    """Anything that drives."""

    def act(self, observation: np.ndarray) -> int:
        """The action for an observation."""

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode; the seed fixes the policy's own random draws."""


class Seedless:
    """A policy of an object that can act, and perhaps be reset, without a seed."""

    def __init__(self, actor: Any) -> None:
        self.act, self._reset = actor.act, getattr(actor, "reset", None)

    def reset(self, seed: int | None = None) -> None:
        """Begin an episode."""
        if callable(self._reset):
            self._reset()


def as_policy(found: Any, whose: str) -> Policy:
    """An object that can act as a policy. Raises ValueError, which says `whose` it is, for one that cannot."""
    if not callable(getattr(found, "act", None)):
        raise ValueError(f"{whose} made {type(found).__name__}, which has no act(observation).")
    try:
        inspect.signature(found.reset).bind(0)
    except (AttributeError, TypeError, ValueError):
        return Seedless(found)
    return found


class StableBaselines:
    """A model of Stable-Baselines3, acting deterministically. Raises ValueError when the file cannot be read."""

    def __init__(self, path: str | Path, env: gym.Env[Any, Any]) -> None:
        self._model = _load_model(Path(path))
        for name in ("observation_space", "action_space"):
            wanted, given = getattr(self._model, name), getattr(env, name)
            if wanted != given:
                raise ValueError(f"{path} was trained for the {name} {wanted}, and this one is {given}.")

    def act(self, observation: np.ndarray) -> int:
        """The model's action."""
        action, _ = self._model.predict(observation, deterministic=True)
        return int(action)

    def reset(self, seed: int | None = None) -> None:
        """Nothing to do."""


def _load_model(path: Path) -> Any:
    """Find out which algorithm wrote the file, by a setting of its own (PPO has A2C's, too), and load it."""
    import stable_baselines3

    try:
        with zipfile.ZipFile(path) as archive:
            settings = json.loads(archive.read("data"))
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise ValueError(f"{path} is no model of Stable-Baselines3 ({error}).") from error
    for algorithm, setting in (("DQN", "exploration_fraction"), ("PPO", "clip_range"), ("A2C", "gae_lambda")):
        if setting in settings:
            return getattr(stable_baselines3, algorithm).load(path, device="cpu")
    raise ValueError(f"{path} was written by none of DQN, PPO and A2C: use --policy FILE:MAKE for others.")


def foreign_policy(name: str, env: gym.Env[Any, Any]) -> Policy:
    """A policy that was not made here: "FILE:MAKE", whose MAKE(env) returns an object with act(observation), or a zip
    file of Stable-Baselines3. Raises ValueError when there is none.
    """
    if name.endswith(".zip"):
        return StableBaselines(name, env)
    make = load_object(name)
    try:
        inspect.signature(make).bind(env)
    except TypeError as error:
        raise ValueError(f"{name} must be a function of one argument, the environment: {error}.") from None
    return as_policy(make(env), name)
