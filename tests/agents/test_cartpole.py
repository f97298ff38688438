"""A task that everybody knows, against a learner that everybody trusts."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.dqn import DQNConfig
from agents.models import Dueling
from agents.training import train

STEPS = 5000
SEEDS = (0, 1, 2)


class Network(Dueling):
    def __init__(self, space: gym.spaces.Box, actions: int) -> None:
        super().__init__(space.shape[0], actions, (64,), (64,))


def mean_return(act: Callable[[np.ndarray], int]) -> float:
    """Over ten greedy episodes."""
    env = gym.make("CartPole-v1")
    total = 0.0
    for seed in range(10):
        observation, _ = env.reset(seed=5000 + seed)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(act(observation))
            total, ended = total + float(reward), terminated or truncated
    return total / 10


@pytest.mark.long
def test_cartpole_is_learnt_as_well_as_by_stable_baselines3() -> None:
    """Equal budget, replay, exploration and width; SB3 has neither the double nor the dueling part."""
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    torch.set_num_threads(1)
    config = DQNConfig(
        updates=STEPS,
        steps_per_update=1,
        batch_size=64,
        learning_rate=1e-3,
        learning_rate_final=1e-3,
        gamma=0.99,
        target_interval=250,
        tau=1.0,
        replay_capacity=20_000,
        warm_up=500,
        standardise=False,
        epsilon_final=0.05,
        epsilon_decay=0.06,
    )
    agents = [train(gym.make("CartPole-v1"), config, seed, network=Network) for seed in SEEDS]
    ours = float(np.median([mean_return(agent.policy.act) for agent in agents]))
    theirs = []
    for seed in SEEDS:
        model = stable_baselines3.DQN(
            "MlpPolicy",
            gym.make("CartPole-v1"),
            seed=seed,
            learning_rate=1e-3,
            buffer_size=20_000,
            learning_starts=500,
            batch_size=64,
            train_freq=1,
            gradient_steps=1,
            target_update_interval=250,
            exploration_fraction=0.16,
            exploration_final_eps=0.05,
            policy_kwargs={"net_arch": [64, 64]},
            device="cpu",
        )
        model.learn(STEPS)
        theirs.append(mean_return(lambda x, m=model: int(m.predict(x, deterministic=True)[0])))
    assert ours > 100  # a random policy gets about 22
    assert ours > 0.7 * float(np.median(theirs))
