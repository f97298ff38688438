"""Stable-Baselines3 has nothing to object to; its DQN trains in examples/ and in sumo/test_many_environments.py."""

from __future__ import annotations

import warnings

import gymnasium as gym
import pytest
from stable_baselines3.common.env_checker import check_env

import sumo_env


@pytest.mark.parametrize("id", sumo_env.IDS)
def test_check_env(id: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gym.make(id))
    # a table of vehicles is neither a vector nor an image; the same is said of highway-env
    assert [str(w.message) for w in caught if "unconventional shape" not in str(w.message)] == []
