"""How near vehicles are and will come, as features of the table: against an independent computation, everywhere."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from experiments.backends import make_env
from sumo_env.config import ConfigError
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.spaces.approach import APPROACH, RANGES
from sumo_env.spaces.observation import Kinematics
from tests.sumo_env.plans import needs_sumo
from tests.sumo_env.scenarios.files import written
from tests.tasks import OF_HIGHWAY_ENV, highway_env_task

PLAIN = ("x", "y", "vx", "vy")
TABLE = {"type": "Kinematics", "vehicles_count": 8}
RAW = {**TABLE, "normalize": False, "features": ["presence", *PLAIN, *APPROACH]}


def expected(relative: np.ndarray) -> np.ndarray:
    """The features of rows (n, 4) of place and velocity, by projection on the direction of the velocity."""
    place, velocity = relative[:, 0] + 1j * relative[:, 1], relative[:, 2] + 1j * relative[:, 3]
    speed = np.abs(velocity)
    course = place * np.exp(-1j * np.angle(velocity))  # real: ahead along the velocity; imaginary: beside it
    time = np.clip(-course.real * speed / (speed**2 + 0.25), 0.0, 6.0)
    nearest = np.hypot(course.real + speed * time, course.imag)
    return np.column_stack([relative, np.abs(place), time, nearest])


def assert_told(table: np.ndarray, absolute: bool) -> None:
    """A table of RAW: the features are those of the places and velocities in its rows, and empty rows are empty."""
    there = table[:, 0] == 1.0
    assert not table[~there].any() and there[0]
    seen = table[there].astype(float)
    relative = seen[:, 1:5] - (seen[0, 1:5] if absolute else 0.0)
    relative[0] = 0.0
    np.testing.assert_allclose(seen[:, 5:], expected(relative), rtol=1e-4, atol=1e-3)  # places are float32


# Of the replica and highway-env's classes in all tasks: test_observation.py, and the kernels below.
PLACES = [*(("sumo", task) for task in OF_HIGHWAY_ENV), ("replica", "exit"), ("highway-env", "u-turn")]


@pytest.mark.parametrize("absolute", [False, True])
@pytest.mark.parametrize(("backend", "task"), PLACES)
def test_they_are_those_of_the_tables_rows_on_every_task(task: str, backend: str, absolute: bool) -> None:
    env = make_env(backend, task, {"observation": {**RAW, "absolute": absolute}, "risk": 1.0})
    observation, _ = env.reset(seed=0)
    ended = False
    while not ended:
        assert_told(observation, absolute)
        observation, _, terminated, truncated, _ = env.step(env.action_space.sample())
        ended = terminated or truncated


@pytest.mark.parametrize("keys", [{}, {"order": "shuffled"}, {"clip": False, "see_behind": True}])
@highway_env_task
def test_kernels_give_the_table_of_the_scene(task: str, keys: dict[str, Any]) -> None:
    """Its rows: of vehicles that are equally far along the lane, rounding decides which comes first."""
    config = {"observation": {**TABLE, "features": ["x", "sin_h", *APPROACH], **keys}}
    env: Any = gym.make(f"replica/{task}-v0", scenarios="seeded", config=config).unwrapped
    env.reset(seed=1)
    for action in np.random.default_rng(0).integers(env.action_space.n, size=8).tolist():
        by_kernel = env._observe()
        form, env.form = env.form, None
        apart = np.abs(by_kernel[:, None] - env._observe()).max(2)
        assert max(apart.min(0).max(), apart.min(1).max()) < 1e-6
        env.form = form
        env.step(action)


@needs_sumo
@pytest.mark.parametrize("absolute", [False, True])
def test_on_a_network_of_ones_own_they_are_along_the_axes_of_the_table(tmp_path, absolute: bool) -> None:
    config = {"observation": {**RAW, "absolute": absolute}}
    env = SumoDrivingEnv(written(tmp_path, "static"), ego_vehicle="ego", config=config)
    observation, _ = env.reset(seed=0)
    for _ in range(25):
        assert_told(observation, absolute)
        observation, *_ = env.step(env.action_space.sample())


def test_they_are_scaled_as_other_features_with_ranges_of_their_own() -> None:
    """A configuration may have other ranges, or none; ranges of what is not named stay out of sight."""
    seen = ["presence", "dx", "tcpa"]
    usual = Kinematics({"features": seen}, 1)
    assert usual.ranges.items() >= {"dx": RANGES["dx"], "tcpa": RANGES["tcpa"]}.items()
    given = Kinematics({"features": seen, "features_range": {"dx": [-30, 30]}}, 1)
    assert given.ranges == {"dx": (-30.0, 30.0), "tcpa": RANGES["tcpa"]}
    assert not {*APPROACH} & {*Kinematics({}, 1).ranges}
    with pytest.raises(ConfigError, match="did you mean 'dcpa'"):
        Kinematics({"features": ["dcpq"]}, 1)
