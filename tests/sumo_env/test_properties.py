"""Any configuration and any action: an episode that ends, or one clear error."""

import copy
import math
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sumo_env.config import COMMON, KINEMATICS, TIME_TO_COLLISION, ConfigError
from sumo_env.env import DrivingEnv
from sumo_env.tasks import TASKS

# What somebody may write where a number, a switch, a list or a dict is expected.
NUMBERS = st.sampled_from(
    [0, 1, 2, 3, 5, 10, 15, 20, 60, 0.5, 1.5, -1, 1e-9, 1e9, 10**30, math.inf, math.nan, True]
)
JUNK = st.sampled_from(
    [None, "", "yes", "10", b"x", [], {}, [1], (0, 1), {"type": None}, object, np.float32(3), 1j]
)
LISTS = st.lists(NUMBERS | JUNK, max_size=4)
FEATURES = st.sampled_from(["presence", "x", "y", "vx", "vy", "heading", "cos_h", "lat_off", "none", 3, None])
DETAILS: dict[str, st.SearchStrategy[Any]] = {
    "type": st.sampled_from(
        ["Kinematics", "TimeToCollision", "OccupancyGrid", "DiscreteMetaAction", "ContinuousAction", None, 1]
    ),
    "features": st.lists(FEATURES, max_size=6) | JUNK,
    "features_range": st.dictionaries(FEATURES, LISTS | st.just([-10, 10]), max_size=2) | JUNK,
    "order": st.sampled_from(["sorted", "shuffled", "none"]) | JUNK,
    "target_speeds": st.lists(NUMBERS, max_size=5) | st.just([20, 25, 30]) | JUNK,
}
PROPERTY = settings(
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


def like(key: str, default: Any) -> st.SearchStrategy[Any]:
    """Values that are of the kind of a default more often than not."""
    if isinstance(default, dict):
        names = st.sampled_from(sorted({*KINEMATICS, *TIME_TO_COLLISION, "longitudinal", "target_speeds"}))
        other = names.flatmap(lambda name: st.tuples(st.just(name), DETAILS.get(name, NUMBERS | JUNK)))
        kind = {"type": "DiscreteMetaAction" if key == "action" else "Kinematics"}
        return st.lists(other, max_size=3).map(lambda pairs: {**kind, **dict(pairs)}) | JUNK
    if isinstance(default, list):
        return st.lists(NUMBERS, min_size=len(default), max_size=len(default)) | LISTS | JUNK
    if isinstance(default, str):
        return st.text(max_size=5) | JUNK | st.just(default)
    return NUMBERS | JUNK


@st.composite
def configs(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """A task and a configuration of it in which a few keys are changed."""
    task = draw(st.sampled_from(sorted(TASKS)))
    known = {**COMMON, **TASKS[task].defaults}
    keys = draw(st.lists(st.sampled_from(sorted(known)), max_size=3, unique=True))
    return task, {key: draw(like(key, known[key])) for key in keys}


def drive_or_refuse(case: tuple[str, dict[str, Any]]) -> None:
    """Drive the first steps, unless the configuration is refused in one line."""
    task, config = case
    given = copy.deepcopy(config)
    try:
        env = DrivingEnv(task, config)
        env.reset(seed=0)
    except ConfigError as error:
        assert str(error).strip() and "\n" not in str(error)
        return
    assert repr(config) == repr(given)  # as it was
    for step in range(3):
        observation, reward, terminated, truncated, _ = env.step(step % len(env.actions))
        assert env.observation_space.contains(observation)
        assert math.isfinite(reward)
        if terminated or truncated:
            break


@pytest.mark.parametrize("count", [100, pytest.param(3000, marks=pytest.mark.long)])
def test_a_configuration_is_driven_or_refused_in_one_line(count: int) -> None:
    settings(PROPERTY, max_examples=count)(given(configs())(drive_or_refuse))()


@pytest.fixture(scope="module")
def env() -> Iterator[DrivingEnv]:
    with closing(DrivingEnv("u-turn")) as env:
        yield env


ACTIONS = NUMBERS | JUNK | st.integers() | st.integers(0, 4).map(np.int64) | st.integers(0, 4).map(np.array)


@settings(PROPERTY, max_examples=100)
@given(actions=st.lists(ACTIONS, min_size=1, max_size=12))
def test_an_action_is_taken_or_refused_in_one_line(env: DrivingEnv, actions: list[Any]) -> None:
    """What is refused changes nothing: the episode is that of the actions that were taken."""
    env.reset(seed=1)
    taken, seen = [], []
    for action in actions:
        try:
            observation, _, terminated, truncated, _ = env.step(action)
        except ValueError as error:
            assert "\n" not in str(error) and repr(action) in str(error)
            continue
        taken.append(action)
        seen.append(observation)
        if terminated or truncated:
            break
    env.reset(seed=1)
    for action, before in zip(taken, seen, strict=True):
        np.testing.assert_array_equal(env.step(action)[0], before)
