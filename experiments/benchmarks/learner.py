"""Updates a second of the learner against Stable-Baselines3's DQN, on the same network.

Both work on batches of the same size from as many stored transitions, in one process and on one thread, in turn. Ours
chooses the next action with the online network (double DQN) and moves its target network with every update, which
Stable-Baselines3 does not do in the function that is timed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.dqn import DQN, DQNConfig
from agents.models import NETWORKS, Standardised
from experiments.benchmarks.remote import Remote, Slice, Stopwatch, median_rate, median_ratio, total

# Observations of four of the five tasks, and of the intersection.
SHAPES = ((5, 5), (15, 7))
ACTIONS = 5
STORED = 10_000  # random transitions in every replay
STRETCH = 20  # updates that one learner makes before the next one takes over: a block of the training
STRETCHES = 20  # in a turn

Record = dict[str, Any]


def _transitions(shape: tuple[int, ...], count: int) -> list[tuple[Any, int, float, Any, bool]]:
    rng = np.random.default_rng(0)
    pairs = rng.uniform(-1.0, 1.0, (count, 2, *shape)).astype(np.float32)
    return [(s, int(rng.integers(ACTIONS)), rng.random(), after, rng.random() < 0.1) for s, after in pairs]


class Ours:
    """An agent of `agents.dqn`."""

    def __init__(self, config: DQNConfig, shape: tuple[int, ...]) -> None:
        self._agent = DQN(config, gym.spaces.Box(-1.0, 1.0, shape), gym.spaces.Discrete(ACTIONS), seed=0)
        for transition in _transitions(shape, STORED):
            self._agent.replay.add(*transition)

    def work(self, updates: int) -> Slice:
        """So many updates."""
        watch = Stopwatch()
        for _ in range(updates):
            self._agent.update()
        return watch.slice(updates)


class StableBaselines:
    """`stable_baselines3.DQN.train` on the same network, batch and number of stored transitions."""

    def __init__(self, config: DQNConfig, shape: tuple[int, ...]) -> None:
        import stable_baselines3
        from stable_baselines3.common.logger import configure
        from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

        space = gym.spaces.Box(-1.0, 1.0, shape)

        class Spaces(gym.Env[Any, int]):
            observation_space = space
            action_space: gym.Space[Any] = gym.spaces.Discrete(ACTIONS)

        class Policy(DQNPolicy):
            def make_q_net(self) -> QNetwork:
                made = super().make_q_net()
                made.features_extractor = torch.nn.Identity()  # type: ignore[assignment]
                made.q_net = Standardised(NETWORKS[config.network](space, ACTIONS), space)  # type: ignore[assignment]
                return made

        self._model = stable_baselines3.DQN(
            Policy, Spaces(), learning_rate=config.learning_rate, batch_size=config.batch_size,
            buffer_size=STORED, gamma=config.gamma, device="cpu", seed=0,
        )  # fmt: skip
        self._model.set_logger(configure(None, []))
        self._batch = config.batch_size
        for before, action, reward, after, terminated in _transitions(shape, STORED):
            self._model.replay_buffer.add(  # type: ignore[union-attr]
                before[None],
                after[None],
                np.array([[action]]),
                np.array([reward]),
                np.array([terminated]),
                [{}],
            )

    def work(self, updates: int) -> Slice:
        """So many gradient steps."""
        watch = Stopwatch()
        self._model.train(gradient_steps=updates, batch_size=self._batch)
        return watch.slice(updates)


class Learners:
    """Both learners with one network, timed in turn; lives in its own process."""

    def __init__(self, network: str, shape: tuple[int, ...]) -> None:
        torch.set_num_threads(1)
        config = replace(DQNConfig(), network=network, replay_capacity=STORED)
        self._network, self._shape = network, shape
        self._learners: dict[str, Ours | StableBaselines] = {
            "own": Ours(config, shape),
            "sb3": StableBaselines(config, shape),
        }

    def measure(self, turns: int) -> Record:
        """Rates are medians over the turns, the ratio is the median of each turn's."""
        for learner in self._learners.values():
            learner.work(STRETCH)  # warms up
        slices: dict[str, list[Slice]] = {name: [] for name in self._learners}
        for _ in range(turns):
            parts: dict[str, list[Slice]] = {name: [] for name in self._learners}
            for _ in range(STRETCHES):  # what slows the machine down for a moment slows both
                for name, learner in self._learners.items():
                    parts[name].append(learner.work(STRETCH))
            for name, stretches in parts.items():
                slices[name].append(total(stretches))
        return {
            "network": self._network,
            "observation": list(self._shape),
            "updates_per_s": median_rate(slices["own"]),
            "sb3_updates_per_s": median_rate(slices["sb3"]),
            "ratio": median_ratio(slices["own"], slices["sb3"]),
        }


def measure_learner(turns: int, note: Callable[[str], None]) -> list[Record]:
    """A record for each network and shape of observation."""
    records = []
    for network in NETWORKS:
        for shape in SHAPES:
            note(f"learner, {network}, {shape[0]} x {shape[1]}")
            with Remote(Learners, network, shape) as learners:
                records.append(learners.call("measure", turns))
    return records
