"""An episode as numbers, printed by its digest: ``python -m tests.sumo_env.rollout JSON``."""

import hashlib
import json
import sys
from collections.abc import Collection, Iterable, Iterator
from dataclasses import asdict, is_dataclass
from itertools import repeat
from typing import Any

import numpy as np

from sumo_env.env import DrivingEnv


def drive(env: Any, actions: int | Iterable[Any] = 1, seed: int | None = None) -> Iterator[tuple[Any, ...]]:
    """What `step` returns until an episode or the actions end; with a seed, the episode begins here."""
    if seed is not None:
        env.reset(seed=seed)
    for action in repeat(actions) if isinstance(actions, int) else actions:
        result = env.step(action)
        yield result
        if result[2] or result[3]:
            return


def observations(env: Any, action: int = 1, seed: int = 0) -> list[np.ndarray]:
    """The observations of an episode."""
    seen = [env.reset(seed=seed)[0]]
    for observation, reward, *_ in drive(env, action):
        assert env.observation_space.contains(observation) and np.isfinite(reward)
        seen.append(observation)
    return seen


def rollout(task: str, seed: int, config: dict[str, Any] | None = None) -> np.ndarray:
    """Observations, reward and ego state of one episode under pseudo-random actions, shape (steps + 1, values)."""
    return record(DrivingEnv(task, config), seed)


def record(env: DrivingEnv, seed: int) -> np.ndarray:
    """As `rollout`, in a given environment."""
    actions = np.random.default_rng(seed + 1).integers(len(env.actions), size=100).tolist()
    observation, info = env.reset(seed=seed)
    rows, results = [], [(observation, 0.0, False, False, info), *drive(env, actions)]
    for seen, reward, _, _, info in results:
        rows.append([*seen.ravel(), reward, info["speed"], info["density"], min(info["min_ttc"], 1e9)])
    return np.array(rows)


def digest(rows: np.ndarray) -> str:
    """A name for the exact bits."""
    return hashlib.sha256(rows.tobytes()).hexdigest()


def leaves(value: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """The values in dictionaries and lists within each other, by the way to each."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from leaves(inner, f"{where}/{key}")
    else:
        yield where, value


def assert_same_bits(ours: Any, theirs: Any, left_out: Collection[str] = ()) -> None:
    """The same bits of the same types, in dictionaries and tuples too; entries `left_out` ours do not have."""
    if is_dataclass(ours) and not isinstance(ours, type):
        ours, theirs = asdict(ours), asdict(theirs)
    if isinstance(ours, dict):
        assert ours.keys() == {key for key in theirs if key.removeprefix("_") not in left_out}
        for key, value in ours.items():
            assert_same_bits(value, theirs[key], left_out)
    elif isinstance(ours, tuple):
        for one, other in zip(ours, theirs, strict=True):
            assert_same_bits(one, other, left_out)
    elif isinstance(ours, np.ndarray) and ours.dtype == object:  # one entry for each environment
        assert_same_bits(tuple(ours), tuple(theirs), left_out)
    else:
        one, other = np.asarray(ours), np.asarray(theirs)
        # numpy's check says it in words, but slowly
        if one.shape != other.shape or one.tobytes() != other.tobytes():
            np.testing.assert_array_equal(one, other)
        assert getattr(ours, "dtype", None) == getattr(theirs, "dtype", None)


def mismatch(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """What two records of one contact do not agree on."""
    apart = [float(np.hypot(crash["relative_x"], crash["relative_y"])) for crash in (one, other)]
    turn = (one["relative_heading"] + other["relative_heading"] + np.pi) % (2 * np.pi) - np.pi
    wrong = []
    if abs(apart[0] - apart[1]) > 1e-6 or abs(turn) > 1e-6:
        wrong.append(f"one contact at {apart[0]:.2f} and {apart[1]:.2f} m, {turn:.2f} rad")
    keys = [key for key in ("type", "time", "detected_by") if one[key] != other[key]]
    return wrong + [f"one contact with two {key}s: {one[key]}, {other[key]}" for key in keys]


if __name__ == "__main__":
    for task, seed, config in json.loads(sys.argv[1]):
        print(digest(rollout(task, seed, config)))
