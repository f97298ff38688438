"""The training of a double DQN: whole episodes, then as many updates as their steps allow.

All draws are the seed's, and every episode begins with ``env.reset(seed=...)``: a training that is killed is begun
again, and gives the same bits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.dqn import DQN, DQNConfig
from agents.episodes import Episodes
from agents.learner import Trained
from agents.streams import episode_seed


class Training:
    """One agent in training, with everything that is written down about it.

    Attributes:
        probe: the agent's first observations, on which its Q-values are watched.
        probe_q: rows of update, mean and largest of max_a |Q| on the probe: the signs of divergence.
    """

    def __init__(self, agent: DQN, env: gym.Env[Any, Any]) -> None:
        self.agent, self.env = agent, Episodes(env)
        self.max_abs_reward = 0.0
        self.probe: np.ndarray | None = None
        self.probe_q: list[list[float]] = []

    def play(self, steps: int) -> None:
        """Play whole episodes until the agent has made at least so many steps in all."""
        while self.env.steps < steps:
            self._play_episode()

    def _play_episode(self) -> None:
        observation, _ = self.env.reset(seed=episode_seed(self.agent.seed, len(self.env.rows["episode"])))
        ended = False
        while not ended:
            action = self.agent.act(observation, self.agent.config.epsilon(self.env.steps))
            after, reward, terminated, truncated, _ = self.env.step(action)
            self.agent.replay.add(observation, action, float(reward), after, bool(terminated))
            observation, ended = after, terminated or truncated
            self.max_abs_reward = max(self.max_abs_reward, abs(float(reward)))

    def watch(self) -> None:
        """Note the Q-values on the probe."""
        if self.probe is None:
            self.probe = self.agent.replay.first(self.agent.config.probe_size)
        size = np.abs(self.agent.q(self.probe)).max(1)
        self.probe_q.append([self.agent.updates, float(size.mean()), float(size.max())])

    def trained(self) -> Trained:
        """What is left when it is over."""
        record = {
            "steps": self.env.steps,
            "updates": self.agent.updates,
            "probe_q": self.probe_q,
            "q_bound": self.max_abs_reward / (1.0 - self.agent.config.gamma),
        }
        return Trained(self.agent.policy(), self.env.columns(), record)


def train(
    env: gym.Env[Any, Any],
    config: DQNConfig,
    seed: int,
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> Trained:
    """Train an agent on ``env`` for ``config.updates`` updates.

    It plays whole episodes until it has made ``config.warm_up`` steps and ``config.steps_per_update`` more for each
    update of the next block, then makes these updates. Torch is set to one thread for the whole process: the order of
    summation, hence the bits, depends on the number of threads, and processes do the parallel work.

    Args:
        env: observations are boxes of any shape, actions ``Discrete``; ``info`` may hold crashed, which
            is logged. Every episode begins with ``reset(seed=...)``.
        config: the settings.
        seed: agents with one seed start with equal weights and meet the same scenarios.
        progress: called with environment steps after every block of updates; what it raises ends the training.

    Raises:
        ValueError: spaces that a DQN cannot handle, or an unknown network.
    """
    torch.set_num_threads(1)
    agent = DQN(config, env.observation_space, env.action_space, seed)
    training = Training(agent, env)
    while (updates := agent.updates) < config.updates:
        done = min(updates + config.block, config.updates)
        training.play(config.warm_up)
        if updates == 0 and config.standardise:
            agent.standardise()
        training.play(config.warm_up + config.steps_per_update * done)
        while agent.updates < done:
            agent.update()
        if done // config.probe_interval > updates // config.probe_interval or done == config.updates:
            training.watch()
        progress(config.warm_up + config.steps_per_update * done)
    return training.trained()
