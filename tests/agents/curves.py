"""Learning curves of the learner on three small tasks, as statistics over training seeds.

`python -m tests.agents.curves` writes learning_curves.json. The stored file is from the learner in numpy that the
one on torch replaced: the same algorithm with the same settings has to learn as fast.
"""

from __future__ import annotations

import json
from pathlib import Path

import gymnasium as gym
import numpy as np

from agents.dqn import DQN, DQNConfig
from agents.training import train
from tests.agents.decision_process import exact_q, experience, risky_road
from tests.agents.road import Road

STORED = Path(__file__).with_name("learning_curves.json")
SEEDS = range(8)
PARTS = 5  # of a training
SMALL = DQNConfig(hidden=(64, 48), stream=(32,), batch_size=64, learning_rate=1e-3)


def road(seed: int) -> list[float]:
    """Mean return of the training episodes in each fifth of 1500 updates on the toy road."""
    config = DQNConfig(**{**vars(SMALL), "updates": 1500, "gamma": 0.95, "target_lag": 100, "epsilon_decay": 0.1})
    (agent,) = train(Road(), config, [seed])
    return by_fifths(agent.episodes)


def cartpole(seed: int) -> list[float]:
    """The same over 3000 updates on CartPole."""
    config = DQNConfig(
        **{**vars(SMALL), "updates": 3000, "target_lag": 150, "warm_up": 300, "epsilon_final": 0.05, "epsilon_decay": 0.1}
    )
    (agent,) = train(gym.make("CartPole-v1"), config, [seed])
    return by_fifths(agent.episodes)


def by_fifths(episodes: dict[str, np.ndarray]) -> list[float]:
    """Mean return of the episodes that end in each fifth of the steps."""
    part = np.ceil(episodes["step"] / episodes["step"][-1] * PARTS) - 1
    return [float(episodes["return"][part == number].mean()) for number in range(PARTS)]


def values(seed: int) -> list[float]:
    """Mean distance of the Q-values from the exact ones after each 400 of 2000 updates, in a known process."""
    process = risky_road()
    expected = exact_q(*process[1:], gamma=0.9)
    agent = DQN(DQNConfig(**{**vars(SMALL), "gamma": 0.9, "target_lag": 50, "batch_size": 100}), 8, 3, seed)
    for transition in experience(process, 5000, seed):
        agent.replay.add(*transition)
    errors = []
    for _ in range(PARTS):
        for _ in range(400):
            agent.update()
        errors.append(float(np.abs([agent.q(feature) for feature in process[0]] - expected).mean()))
    return errors


CURVES = {"road": road, "cartpole": cartpole, "values": values}


def measure() -> dict[str, dict[str, list[float]]]:
    """Mean and standard deviation over the seeds at each point of each curve."""
    result = {}
    for name, curve in CURVES.items():
        table = np.array([curve(seed) for seed in SEEDS])
        result[name] = {"mean": table.mean(0).round(5).tolist(), "sd": table.std(0, ddof=1).round(5).tolist()}
    return result


if __name__ == "__main__":
    STORED.write_text(json.dumps(measure(), indent=1) + "\n")
