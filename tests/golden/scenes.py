"""The first policy steps of an episode under fixed actions: what the environment shows and where the vehicles are."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import sumo_env  # noqa: F401  (registers the environments)
from sumo_env.scene import Scene
from sumo_env.tasks import TASKS
from tests.sumo_env.rollout import drive, leaves

RISKS = (0.0, 1.0)
SEEDS = (7, 8)
# By their number. Of five: left, faster, right, slower; of three: faster, slower, idle, faster.
ACTIONS = {5: (0, 3, 2, 4), 3: (2, 0, 1, 2)}
NEAREST = 8  # vehicles that are written down one by one
DIGITS = 7
# Headings are given in [-1, 2 pi - 1): which turn they are counted in is nobody's matter, and no road heads for -1 rad.
TOLERANCE = 1e-6  # [m, m/s, rad] and of observations and rewards


def cells(task: str) -> Iterator[tuple[str, float]]:
    """The lowest and the highest traffic level of a task (or its one), by name, with regular and risky traffic."""
    levels = list(TASKS[task].levels)
    for level in dict.fromkeys((levels[0], levels[-1])):
        for risk in RISKS:
            yield level, risk


def make(task: str, level: str, risk: float) -> gym.Env[Any, Any]:
    """The environment of a cell."""
    return gym.make(f"sumo/{task}-v0", config={**TASKS[task].levels[level], "risk": risk})


def table(task: str) -> dict[str, Any]:
    """All cells and seeds of a task: name of the episode -> its steps, the state after the reset first."""
    result = {}
    for level, risk in cells(task):
        env: Any = make(task, level, risk)
        for seed in SEEDS:
            name = f"level {level}, risk {risk:g}, seed {seed}"
            result[name] = episode(env, seed, ACTIONS[env.action_space.n])
        env.close()
    return result


def episode(env: gym.Env[Any, Any], seed: int, actions: tuple[int, ...]) -> list[dict[str, Any]]:
    """The steps of one episode, until it ends or the actions do."""
    inner: Any = env.unwrapped
    observation, _ = env.reset(seed=seed)
    scene = inner.scene
    distance = np.hypot(scene.x - scene.x[0], scene.y - scene.y[0])
    followed = [scene.ids[row] for row in np.argsort(distance, kind="stable")[: NEAREST + 1]]
    steps = [{**state(scene, followed, scene), "observation": rounded(observation)}]
    for observation, reward, terminated, truncated, _ in drive(env, actions):
        ends = {"reward": rounded(reward), "terminated": bool(terminated), "truncated": bool(truncated)}
        now = state(inner.scene, followed, scene)
        steps.append({**ends, **now, "observation": rounded(observation)})
        scene = inner.scene
    return steps


def state(scene: Scene, followed: list[str], before: Scene) -> dict[str, Any]:
    """A scene in few numbers.

    Returns:
        time [s]; number of vehicles; names that appeared and disappeared; mean of x, y, speed and of the heading's
        cosine and sine over all vehicles; crashed: names of the wrecks; vehicles: x, y, speed, heading of the
        followed ones.
    """
    columns = np.stack([scene.x, scene.y, scene.speed, np.mod(scene.heading + 1, 2 * np.pi) - 1])
    means = np.stack([scene.x, scene.y, scene.speed, np.cos(scene.heading), np.sin(scene.heading)])
    rows = {name: row for row, name in enumerate(scene.ids)}
    return {
        "time": rounded(scene.time),
        "count": len(scene.ids),
        "appeared": [name for name in scene.ids if name not in before.ids],
        "disappeared": [name for name in before.ids if name not in scene.ids],
        "crashed": [name for name, crashed in zip(scene.ids, scene.crashed, strict=True) if crashed],
        "mean": rounded(means.mean(axis=1)),
        "vehicles": {name: rounded(columns[:, rows[name]]) for name in followed if name in rows},
    }


def rounded(values: Any) -> Any:
    """Numbers as JSON has them; never minus zero."""
    return (np.round(np.asarray(values, dtype=float), DIGITS) + 0.0).tolist()


def differences(now: Any, then: Any) -> list[str]:
    """Every place at which two JSON values differ: numbers by more than the tolerance, all else at all."""
    ours, golden = dict(leaves(now)), dict(leaves(then))
    if list(ours) != list(golden):
        return [f"{sorted(ours.keys() ^ golden.keys())} on one side only, or in another order"]
    return [
        f"{where}: {ours[where]!r}, golden {value!r}"
        for where, value in golden.items()
        if ours[where] != pytest.approx(value, abs=TOLERANCE)
    ]
