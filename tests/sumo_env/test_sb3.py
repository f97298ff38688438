"""Stable-Baselines3 as its users write it: highway-env's own training script with the id changed."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.evaluation import evaluate_policy

import sumo_env


@pytest.fixture
def one_thread() -> Iterator[None]:
    """More threads than cores would take minutes for so small a network."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.mark.parametrize("id", sumo_env.IDS)
def test_check_env(id: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gym.make(id))
    # a table of vehicles is neither a vector nor an image; the same is said of highway-env
    assert [str(w.message) for w in caught if "unconventional shape" not in str(w.message)] == []


@pytest.mark.slow
def test_dqn_as_in_highway_envs_script(tmp_path: Path, one_thread: None) -> None:
    """scripts/sb3_highway_dqn.py of highway-env, fewer steps: 600, after which it drives better than chance."""
    env = gym.make("sumo/highway-v0", render_mode="rgb_array")
    env.unwrapped.configure({"vehicles_count": 20, "lanes_count": 3, "duration": 30})  # type: ignore[attr-defined]
    env.reset(seed=0)
    model = DQN(
        "MlpPolicy",
        env,
        policy_kwargs={"net_arch": [256, 256]},
        learning_rate=5e-4,
        buffer_size=15000,
        learning_starts=200,
        batch_size=32,
        gamma=0.8,
        train_freq=1,
        gradient_steps=1,
        target_update_interval=50,
        verbose=0,
        seed=0,
    )
    before = [parameter.detach().clone() for parameter in model.policy.parameters()]
    model.learn(total_timesteps=600)
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters(), strict=True))
    model.save(tmp_path / "model")
    del model

    model = DQN.load(tmp_path / "model", env=env)
    observation, _ = env.reset(seed=1)
    action, _ = model.predict(observation, deterministic=True)
    env.step(action)
    values = model.q_net(model.q_net.obs_to_tensor(observation)[0]).detach().numpy()
    assert np.isfinite(values).all()
    assert 1.0 < values.max() < 6.0  # rewards of about 0.8 at gamma 0.8: it has learnt what a state is worth
    mean, _ = evaluate_policy(model, env, n_eval_episodes=3, warn=False)
    assert mean > 0.0
