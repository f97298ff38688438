"""Policies: what a study can test, whether it learnt here, learnt elsewhere or never learnt.

Learnt here: :class:`agents.greedy.Greedy`. Learnt elsewhere: :class:`StableBaselines`, and any object of a user's file.
Never learnt: `agents.rules`.
"""

import hashlib
import inspect
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import numpy as np

from agents.plugins import foreign, load_object, sha256
from agents.reading import files_read

NORMALIZE = "vecnormalize.pkl"  # beside a zip file: what its training's `VecNormalize.save` wrote


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
    """A model of Stable-Baselines3, acting deterministically.

    Where "vecnormalize.pkl" lies beside it, it sees observations as it did in training behind that `VecNormalize`.

    Raises ValueError when a file cannot be read, or is of other observations or actions.
    """

    def __init__(self, path: str | Path, env: gym.Env[Any, Any]) -> None:
        self._model = _load_model(Path(path))
        for name in ("observation_space", "action_space"):
            wanted, given = getattr(self._model, name), getattr(env, name)
            if wanted != given:
                raise ValueError(f"{path} was trained for the {name} {wanted}, and this one is {given}.")
        statistics = Path(path).with_name(NORMALIZE)
        self._normalize = _load_normalize(statistics, env) if statistics.exists() else None

    def act(self, observation: np.ndarray) -> int:
        """The model's action."""
        if self._normalize is not None:
            observation = self._normalize.normalize_obs(observation)
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


def _load_normalize(path: Path, env: gym.Env[Any, Any]) -> Any:
    """The statistics of observations that `VecNormalize.save` has written."""
    from stable_baselines3.common.vec_env import VecNormalize

    try:
        with path.open("rb") as file:
            found = pickle.load(file)  # as the model beside it, it runs code
    except Exception as error:  # whatever a damaged pickle ends in
        raise ValueError(f"{path} cannot be read ({type(error).__name__}: {error}).") from error
    if not isinstance(found, VecNormalize) or found.observation_space != env.observation_space:
        raise ValueError(f"{path} is no VecNormalize of the model's observations: move one of both away.")
    return found


def foreign_policy(name: str, env: gym.Env[Any, Any]) -> tuple[Policy, str]:
    """A policy that was not made here, and the SHA-256 of what it is: its file, and the files that it reads when made.

    name: "FILE:MAKE", whose MAKE(env) returns an object with act(observation), or a zip file of Stable-Baselines3.

    Raises ValueError when there is none.
    """
    _, digest = foreign(name)
    with files_read() as files:
        policy = StableBaselines(name, env) if name.endswith(".zip") else _made(name, env)
    others = sorted(sha256(path) for path in files - {Path(name).resolve()})  # a zip file is known already
    return policy, hashlib.sha256(" ".join([digest, *others]).encode()).hexdigest() if others else digest


def _made(name: str, env: gym.Env[Any, Any]) -> Policy:
    """The policy of "FILE:MAKE"."""
    make = load_object(name)
    try:
        inspect.signature(make).bind(env)
    except TypeError as error:
        raise ValueError(f"{name} must be a function of one argument, the environment: {error}.") from None
    try:
        found = make(env)
    except Exception as error:
        raise ValueError(f"{name} cannot make a policy: {type(error).__name__}: {error}") from error
    return as_policy(found, name)
