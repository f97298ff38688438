"""A finite horizon: the time is observed by the ego, and its end is terminal in training only."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import sumo_env  # noqa: F401  (registers the ids)
from experiments.study.wrappers import TimeObserved, observed, trained_on
from tests.experiments.fake_env import make_env

FINITE, PLAIN = {"finite_horizon": True}, {"finite_horizon": False}
SLOWER = 4


def test_the_time_is_a_column_of_the_ego() -> None:
    env = observed(make_env("sumo", "u-turn"), FINITE)
    plain = make_env("sumo", "u-turn")
    assert env.observation_space.shape == (2, 6)
    for episode in range(2):  # which begins at 0 again
        seen, raw = env.reset(seed=episode)[0], plain.reset(seed=episode)[0]
        for step in range(11):
            assert env.observation_space.contains(seen)
            np.testing.assert_array_equal(seen[:, :-1], raw)
            assert seen[0, -1] == pytest.approx(step / 10)
            assert (seen[1:, -1] == 0).all()
            if step < 10:
                seen, *_, truncated, _ = env.step(SLOWER)
                raw = plain.step(SLOWER)[0]
    assert truncated


def test_the_limit_is_terminal_in_training_and_truncates_in_the_test() -> None:
    ends = []
    for env in (trained_on(make_env("sumo", "u-turn"), FINITE), observed(make_env("sumo", "u-turn"), FINITE)):
        env.reset(seed=0)
        for _ in range(10):
            _, _, terminated, truncated, _ = env.step(SLOWER)
        ends.append((terminated, truncated))
    assert ends == [(True, False), (False, True)]


def test_without_a_finite_horizon_nothing_is_wrapped() -> None:
    env = make_env("sumo", "u-turn")
    assert observed(env, PLAIN) is env and trained_on(env, PLAIN) is env and observed(env, {}) is env


def test_gymnasium_accepts_the_environment() -> None:
    check_env(TimeObserved(gym.make("sumo/roundabout-v0").unwrapped, 11), skip_render_check=True)


def test_other_observations_are_refused() -> None:
    with pytest.raises(ValueError, match="vehicles, features"):
        TimeObserved(gym.make("CartPole-v1"), 10)
