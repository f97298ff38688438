"""Updates a second of the learner, against Stable-Baselines3's DQN and against the bare arithmetic.

All of them work on batches of the same size, from networks of the same layers, in one process and on one
thread, in turn. Stable-Baselines3 has no dueling network; it gets one here, built of its own parts, so that
both do the same arithmetic but for the next action: ours is chosen by the online network (double DQN), which
costs us one forward pass more.
"""

from __future__ import annotations

import time
import timeit
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn

from agents.architecture import Architecture
from agents.dqn import DQN, DQNConfig
from experiments.benchmarks.remote import Remote, Slice, Stopwatch, median_rate, median_ratio

OBSERVATION = (5, 5)  # of four of the five tasks
ACTIONS = 5
STORED = 1000  # random transitions in every replay
SPACE = gym.spaces.Box(-1.0, 1.0, OBSERVATION, np.float32)

Record = dict[str, Any]


class Ours:
    """`count` agents of `agents.dqn` that learn in turn, a block of updates each, as in training."""

    def __init__(self, config: DQNConfig, count: int) -> None:
        inputs = int(np.prod(OBSERVATION))
        self._agents = [DQN(config, inputs, ACTIONS, seed) for seed in range(count)]
        self._block = config.block
        rng = np.random.default_rng(0)
        for agent in self._agents:
            for _ in range(STORED):
                before, after = rng.uniform(-1.0, 1.0, (2, inputs))
                agent.replay.add(before, int(rng.integers(ACTIONS)), rng.random(), after, rng.random() < 0.1)

    def work(self, updates: int) -> Slice:
        """At least `updates` updates, the same number for every agent."""
        rounds = max(round(updates / (self._block * len(self._agents))), 1)
        watch = Stopwatch()
        for _ in range(rounds):
            for agent in self._agents:
                for _ in range(self._block):
                    agent.update()
        return watch.slice(rounds * self._block * len(self._agents))


class Floor:
    """The matrix products of one update and nothing else: the least time that the arithmetic can take.

    Forward of the online network on s and, in double DQN, on s', forward of the target network on s', and two
    products a layer backward; each by the quicker of numpy and torch.
    """

    def __init__(self, config: DQNConfig) -> None:
        architecture = config.architecture(int(np.prod(OBSERVATION)), ACTIONS)
        batch = config.batch_size
        rows = 2 * batch if config.double else batch
        self._products = [
            *_products(architecture, rows, batch, backward=True),
            *_products(architecture, batch, batch, backward=False),
        ]
        self._calls = [
            min(
                partial(np.dot, a, b, out=out),
                partial(torch.mm, *map(torch.from_numpy, (a, b)), out=torch.from_numpy(out)),
                key=_seconds,
            )
            for a, b, out in self._products
        ]

    def work(self, updates: int) -> Slice:
        """The products of so many updates."""
        calls = self._calls
        watch = Stopwatch()
        for _ in range(updates):
            for call in calls:
                call()
        return watch.slice(updates)


def _seconds(product: Callable[[], object]) -> float:
    """Processor time of some calls [s], the least of several tries."""
    return min(timeit.repeat(product, timer=time.process_time, number=20, repeat=9))


def _products(
    architecture: Architecture, rows: int, batch: int, backward: bool
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Operands and result of every product of a pass over `rows` observations, `batch` of them differentiated."""
    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    products = []
    for layer in architecture.layers:
        x, weight = normal(rows, layer.fan_in), normal(layer.fan_in, layer.fan_out)
        products.append((x, weight, normal(rows, layer.fan_out)))
        if backward:
            delta = normal(batch, layer.fan_out)
            products.append((x[:batch].T, delta, normal(layer.fan_in, layer.fan_out)))
            if layer.source >= 0:
                products.append((delta, weight.T, normal(batch, layer.fan_in)))
    return products


class Dueling(nn.Module):
    """The paper's network of torch's own layers, for Stable-Baselines3."""

    def __init__(self, config: DQNConfig, inputs: int) -> None:
        super().__init__()
        self.base = _mlp((inputs, *config.hidden))
        last = config.hidden[-1]
        self.value = nn.Sequential(_mlp((last, *config.stream)), nn.Linear(config.stream[-1], 1))
        self.advantage = nn.Sequential(_mlp((last, *config.stream)), nn.Linear(config.stream[-1], ACTIONS))

    def forward(self, observations: Tensor) -> Tensor:
        """Q-values of flattened observations."""
        base = self.base(observations)
        advantage = self.advantage(base)
        return self.value(base) + advantage - advantage.mean(-1, keepdim=True)


def _mlp(widths: Sequence[int]) -> nn.Sequential:
    layers: list[nn.Module] = []
    for fan_in, fan_out in pairwise(widths):
        layers += [nn.Linear(fan_in, fan_out), nn.ReLU()]
    return nn.Sequential(*layers)


class _Spaces(gym.Env[Any, int]):
    """Stable-Baselines3 wants an environment to know its spaces; nobody drives it."""

    observation_space = SPACE
    action_space: gym.Space[Any] = gym.spaces.Discrete(ACTIONS)

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        return np.zeros(OBSERVATION, np.float32), {}

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return np.zeros(OBSERVATION, np.float32), 0.0, True, False, {}


class StableBaselines:
    """`stable_baselines3.DQN.train` on the same network, batch and number of stored transitions."""

    def __init__(self, config: DQNConfig) -> None:
        import stable_baselines3
        from stable_baselines3.common.logger import configure
        from stable_baselines3.dqn.policies import DQNPolicy, QNetwork

        class DuelingPolicy(DQNPolicy):
            def make_q_net(self) -> QNetwork:
                network = super().make_q_net()
                network.q_net = Dueling(config, network.features_dim)  # type: ignore[assignment]
                return network

        self._model = stable_baselines3.DQN(
            DuelingPolicy, _Spaces(), learning_rate=config.learning_rate, batch_size=config.batch_size,
            buffer_size=STORED, gamma=config.gamma, device="cpu", seed=0,
        )  # fmt: skip
        self._model.set_logger(configure(None, []))
        self._batch = config.batch_size
        rng = np.random.default_rng(0)
        for _ in range(STORED):
            before, after = rng.uniform(-1.0, 1.0, (2, 1, *OBSERVATION)).astype(np.float32)
            self._model.replay_buffer.add(  # type: ignore[union-attr]
                before, after, rng.integers(ACTIONS, size=(1, 1)), rng.random(1), rng.random(1) < 0.1, [{}]
            )

    def work(self, updates: int) -> Slice:
        """So many gradient steps."""
        watch = Stopwatch()
        self._model.train(gradient_steps=updates, batch_size=self._batch)
        return watch.slice(updates)


class Learners:
    """All variants in one process, timed in turn; lives in its own process."""

    def __init__(self, agents: Sequence[int]) -> None:
        torch.set_num_threads(1)
        config = DQNConfig()
        self._counts = tuple(agents)
        self._variants: dict[Any, Any] = {"sb3": StableBaselines(config), "floor": Floor(config)}
        for count in self._counts:
            self._variants[count] = Ours(config, count)

    def measure(self, turns: int, updates: int) -> list[Record]:
        """One record a number of agents; rates are medians over the turns, ratios those of each turn."""
        slices: dict[Any, list[Slice]] = {name: [] for name in self._variants}
        for turn in range(turns + 1):
            for name, variant in self._variants.items():
                part = variant.work(updates)
                if turn > 0:  # the first one warms up
                    slices[name].append(part)
        return [
            {
                "variant": "own",
                "agents": count,
                "updates_per_s": median_rate(slices[count]) / count,
                "updates_per_s_together": median_rate(slices[count]),
                "sb3_updates_per_s": median_rate(slices["sb3"]),
                "ratio": median_ratio(slices[count], slices["sb3"]),
                "floor_updates_per_s": median_rate(slices["floor"]),
                "over_floor": 1.0 / median_ratio(slices[count], slices["floor"]),
            }
            for count in self._counts
        ]


def measure_learner(
    agents: Sequence[int], turns: int, updates: int, note: Callable[[str], None]
) -> list[Record]:
    """Records of the learner for several numbers of agents in one process."""
    note("learner")
    with Remote(Learners, agents) as learners:
        records: list[Record] = learners.call("measure", turns, updates)
    return records
