"""Updates a second of the learner, against Stable-Baselines3's DQN and against the bare arithmetic.

All of them work on batches of the same size, from networks of the same layers, in one process and on one
thread, in turn; numpy's products with the quickest kernels that its OpenBLAS has for the processor.
Stable-Baselines3 has no dueling network; it gets one here, built of its own parts, so that both learn the same
but for the next action: ours is chosen by the online network (double DQN), which costs us one forward pass more;
Stable-Baselines3 copies its target network outside of the function that is timed.
"""

from __future__ import annotations

import itertools
import os
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
from experiments.benchmarks.remote import Remote, Slice, Stopwatch, median_rate, median_ratio, total
from experiments.support.threads import KERNELS, quickest_kernels

OBSERVATION = (5, 5)  # of four of the five tasks
ACTIONS = 5
# Random transitions in every replay: as many as the default budget holds on average. How many there are decides
# what the target network costs us.
STORED = 10_000
STRETCH = 20  # updates that one variant makes before the next one takes over: a block of the training
CONFIG = DQNConfig(replay_capacity=STORED)
DEFAULT = "OpenBLAS's choice"  # of kernels
SPACE = gym.spaces.Box(-1.0, 1.0, OBSERVATION, np.float32)

Record = dict[str, Any]


class Ours:
    """`count` agents of `agents.dqn` that learn in turn.

    Their next target copies are spread evenly: as many updates of all of them as lie between two copies of one
    hold one copy, however many agents there are.
    """

    def __init__(self, config: DQNConfig, count: int) -> None:
        inputs = int(np.prod(OBSERVATION))
        agents = [DQN(config, inputs, ACTIONS, seed) for seed in range(count)]
        self._rng = np.random.default_rng(0)
        each = config.target_lag // count
        for number, agent in enumerate(agents):
            for _ in range(STORED):
                self._step(agent)
            agent.update()  # which evaluates all that is stored
            agent.updates = number * each
        self._turns = itertools.cycle([agent for agent in agents for _ in range(each)])

    def work(self, updates: int) -> Slice:
        """So many updates, after as many steps, which are not timed but have to be evaluated in the updates."""
        agents = list(itertools.islice(self._turns, updates))
        for agent in agents:
            self._step(agent)
        watch = Stopwatch()
        for agent in agents:
            agent.update()
        return watch.slice(updates)

    def _step(self, agent: DQN) -> None:
        rng = self._rng
        before, after = rng.uniform(-1.0, 1.0, (2, agent.architecture.inputs))
        agent.replay.add(before, int(rng.integers(ACTIONS)), rng.random(), after, rng.random() < 0.1)


class Floor:
    """The matrix products of one update and nothing else: the least time that the arithmetic can take.

    Forward of the online network on s and, in double DQN, its advantage on s', two products a layer backward, and
    forward of the target network on every stored s' between two of its copies. Each by the quicker of numpy and
    torch, which is found out in use.
    """

    def __init__(self, config: DQNConfig) -> None:
        architecture = config.architecture(int(np.prod(OBSERVATION)), ACTIONS)
        batch = config.batch_size
        ranked = batch if config.double else 0
        self.online = _products(architecture, batch, ranked, backward=True)
        self.target = _products(architecture, batch, 0, backward=False)
        self.target_passes = STORED / batch / config.target_lag  # in an update
        self._online, self._target = _calls(self.online), _calls(self.target)
        self._owed = 0.0  # passes of the target network

    def work(self, updates: int) -> Slice:
        """The products of so many updates."""
        watch = Stopwatch()
        for _ in range(updates):
            for call in self._online:
                call()
            self._owed += self.target_passes
            while self._owed >= 1.0:
                self._owed -= 1.0
                for call in self._target:
                    call()
        return watch.slice(updates)


Product = tuple[np.ndarray, np.ndarray, np.ndarray]  # operands and result


def _calls(products: Sequence[Product]) -> list[Callable[[], object]]:
    """Each product by the quicker of numpy and torch."""
    return [
        min(
            partial(np.dot, a, b, out=out),
            partial(torch.mm, *map(torch.from_numpy, (a, b)), out=torch.from_numpy(out)),
            key=_seconds,
        )
        for a, b, out in products
    ]


def _seconds(product: Callable[[], object]) -> float:
    """Processor time of some calls [s], the least of several tries."""
    return min(timeit.repeat(product, timer=time.process_time, number=20, repeat=9))


def _products(architecture: Architecture, batch: int, ranked: int, backward: bool) -> list[Product]:
    """Every product of a pass over `batch` observations, and over `ranked` more without the value stream."""
    rng = np.random.default_rng(0)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, np.float32)

    shared = len(architecture.hidden)
    products = []
    for index, layer in enumerate(architecture.layers):
        rows = batch if shared <= index <= architecture.value_output else batch + ranked
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
    """All variants in one process, timed in turn; lives in its own process.

    A turn is as many updates as lie between two target copies, in short stretches of one variant after the other:
    what slows the machine down for a moment slows all of them.
    """

    def __init__(self, agents: Sequence[int]) -> None:
        torch.set_num_threads(1)
        self._counts = tuple(agents)
        self._variants: dict[Any, Any] = {"sb3": StableBaselines(CONFIG), "floor": Floor(CONFIG)}
        for count in self._counts:
            self._variants[count] = Ours(CONFIG, count)

    def measure(self, turns: int) -> list[Record]:
        """One record a number of agents; rates are medians over the turns, ratios those of each turn."""
        for variant in self._variants.values():
            variant.work(STRETCH)  # warms up
        slices: dict[Any, list[Slice]] = {name: [] for name in self._variants}
        for _ in range(turns):
            parts: dict[Any, list[Slice]] = {name: [] for name in self._variants}
            for _ in range(CONFIG.target_lag // STRETCH):
                for name, variant in self._variants.items():
                    parts[name].append(variant.work(STRETCH))
            for name in parts:
                slices[name].append(total(parts[name]))
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


def measure_learner(agents: Sequence[int], turns: int, note: Callable[[str], None]) -> list[Record]:
    """Records of the learner for several numbers of agents in one process, with OpenBLAS's quickest kernels.

    Where the user's environment names other kernels, which training obeys, one agent is measured with these as well.
    """
    quickest, named = quickest_kernels() or "", os.environ.get(KERNELS, "")
    records = _measure(agents, turns, quickest, note)
    if named.lower() not in ("", quickest.lower()):
        slower = _measure(agents[:1], max(turns // 3, 1), named, note)
        records += [{**record, "variant": "named kernels"} for record in slower]
    return records


def _measure(agents: Sequence[int], turns: int, kernels: str, note: Callable[[str], None]) -> list[Record]:
    note(f"learner, kernels {kernels or DEFAULT}")
    with Remote(Learners, agents, kernels=kernels) as learners:
        records: list[Record] = learners.call("measure", turns)
    return [{**record, "kernels": kernels or DEFAULT} for record in records]
