"""Learning curves of the learner on two small tasks, as statistics over training seeds.

`python -m tests.agents.curves` writes learning_curves.json. The stored file is from the learner in numpy that the
one on torch replaced: the same algorithm with the same settings has to learn as fast (tests/golden has the toy road).
"""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

from agents.dqn import DQN, DQNConfig
from agents.models import Dueling
from agents.training import train
from tests.agents.decision_process import exact_q, experience, risky_road

STORED = Path(__file__).with_name("learning_curves.json")
SEEDS = range(8)
PARTS = 5  # of a training


class Config(DQNConfig):
    """Explores as the learner in numpy did: epsilon falls from the first step."""

    def epsilon(self, step: int) -> float:
        return super().epsilon(step + self.warm_up)


# The settings of the learner in numpy, which clamped each entry of the gradient where this one limits its norm.
SMALL = Config(
    batch_size=64,
    learning_rate=1e-3,
    learning_rate_final=1e-3,
    gamma=0.99,
    steps_per_update=1,
    tau=1.0,
    warm_up=100,
    standardise=False,
)


class Network(Dueling):
    """The paper's kind of network, smaller."""

    def __init__(self, space: gym.spaces.Box, actions: int) -> None:
        super().__init__(int(np.prod(space.shape)), actions, (64, 48), (32,))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return super().forward(x.flatten(1))


def cartpole(seed: int) -> list[float]:
    """Mean return of the training episodes in each fifth of 3000 updates on CartPole."""
    config = Config(
        **{
            **vars(SMALL),
            "updates": 3000,
            "target_interval": 150,
            "warm_up": 300,
            "epsilon_final": 0.05,
            "epsilon_decay": 0.1,
        }
    )
    agent = train(gym.make("CartPole-v1"), config, seed, network=Network)
    return by_fifths(agent.episodes)


def by_fifths(episodes: dict[str, np.ndarray]) -> list[float]:
    """Mean return of the episodes that end in each fifth of the steps."""
    part = np.ceil(episodes["step"] / episodes["step"][-1] * PARTS) - 1
    return [float(episodes["return"][part == number].mean()) for number in range(PARTS)]


def values(seed: int) -> list[float]:
    """Mean distance of the Q-values from the exact ones after each 400 of 2000 updates, in a known process."""
    process = risky_road()
    expected = exact_q(*process[1:], gamma=0.9)
    config = Config(**{**vars(SMALL), "gamma": 0.9, "target_interval": 50, "batch_size": 100})
    spaces = gym.spaces.Box(-np.inf, np.inf, (8,)), gym.spaces.Discrete(3)
    agent = DQN(config, *spaces, seed, network=Network)
    for transition in experience(process, 5000, seed):
        agent.replay.add(*transition)
    errors = []
    for _ in range(PARTS):
        for _ in range(400):
            agent.update()
        errors.append(float(np.abs(agent.q(process[0]) - expected).mean()))
    return errors


CURVES = {"cartpole": cartpole, "values": values}


def measure() -> dict[str, dict[str, list[float]]]:
    """Mean and standard deviation over the seeds at each point of each curve."""
    result = {}
    for name, curve in CURVES.items():
        table = np.array([curve(seed) for seed in SEEDS])
        result[name] = {"mean": table.mean(0).round(5).tolist(), "sd": table.std(0, ddof=1).round(5).tolist()}
    return result


if __name__ == "__main__":
    STORED.write_text(json.dumps(measure(), indent=1) + "\n")
