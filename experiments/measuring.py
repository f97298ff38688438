"""What `benchmark.py` measures, each in a process of its own, and the processor time that it takes.

Two processes that are compared take turns and never run at the same time, so that both meet the same machine.
"""

from __future__ import annotations

import multiprocessing
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.managers import BaseManager
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from experiments.backends import make_env
from experiments.support.processes import end_with_parent

ROOT = Path(__file__).resolve().parents[1]
STORED = 10_000  # random transitions in every replay


@dataclass(frozen=True)
class Slice:
    """A stretch of work: how much of it, in which processor time [s]."""

    count: int
    cpu: float

    @property
    def per_second(self) -> float:
        """Rate in processor time: what one core does, whoever else uses the machine."""
        return self.count / self.cpu


def median_rate(slices: Sequence[Slice]) -> float:
    """Median over the turns of what one second of processor time brings."""
    return statistics.median(part.per_second for part in slices)


def median_ratio(ours: Sequence[Slice], theirs: Sequence[Slice]) -> float:
    """Median over the turns of our rate over theirs."""
    return statistics.median(a.per_second / b.per_second for a, b in zip(ours, theirs, strict=True))


def _make(factory: Callable[..., Any], *arguments: Any) -> Any:
    return factory(*arguments)


class Server(BaseManager):
    """A process that holds an object."""


Server.register("make", _make)


@contextmanager
def remote(factory: Callable[..., Any], *arguments: Any) -> Iterator[Any]:
    """An object in a spawned process, with its public methods; `factory` makes it there from the arguments."""
    server: Any = Server(ctx=multiprocessing.get_context("spawn"))
    server.start(initializer=end_with_parent)
    try:
        yield server.make(factory, *arguments)
    finally:
        server.shutdown()


class Driver:
    """Drives one environment with random actions, as an exploring agent does: resets count in full."""

    def __init__(self, backend: str, task: str, config: Mapping[str, Any]) -> None:
        self._env: Any = make_env(backend, task, config)
        self._env.action_space.seed(0)
        self._episodes, self._done = 0, True
        self._resets: list[float] = []
        self.drive(0.0, 2)  # loads the network, compiles, fills caches
        self._resets.clear()

    def _reset(self, risk: float = 0.0) -> None:
        start = time.process_time()
        self._env.reset(seed=self._episodes, options={"config": {"risk": risk}} if risk else None)
        self._resets.append(time.process_time() - start)
        self._episodes += 1

    def _step(self) -> None:
        _, _, terminated, truncated, _ = self._env.step(int(self._env.action_space.sample()))
        self._done = terminated or truncated

    def drive(self, seconds: float, least: int = 1, whole: bool = True) -> Slice:
        """Take steps for some time.

        whole: to the end of the last episode, so that a slice holds its share of resets; not for simulators in which an
        episode takes too long.
        """
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < least or time.perf_counter() - begun < seconds or (whole and not self._done):
            if self._done:
                self._reset()
            self._step()
            steps += 1
        return Slice(steps, time.process_time() - cpu)

    def bare_engine(self, seconds: float, episode: int) -> Slice:
        """SUMO's own steps with the same vehicles on the road and nobody who reads or commands; counts policy steps.

        It takes as many steps of SUMO as an episode of this length does, a warm-up included.
        """
        from sumo_env.sumo.session import libsumo  # the only importer of it

        env = self._env.unwrapped
        frequency = env.config["simulation_frequency"]
        begun, cpu, count, usual = time.perf_counter(), 0.0, 0, len(self._resets)
        while not count or time.perf_counter() - begun < seconds:
            self._reset()
            steps = round(env.scenario.warm_up * frequency)
            steps += episode * frequency // env.config["policy_frequency"]
            start = time.process_time()
            for _ in range(steps):
                libsumo.simulationStep()
            cpu, count = cpu + time.process_time() - start, count + episode
        self._reset()
        del self._resets[usual:]  # SUMO's clock has been moved, so that these have loaded the network anew
        return Slice(count, cpu)

    def reset_ms(self) -> float:
        """Median processor time of the resets so far [ms]."""
        return 1e3 * statistics.median(self._resets)

    def episode_steps(self) -> int:
        """Mean length of the random episodes [policy steps]."""
        before, part = len(self._resets), self.drive(0.0, 40)
        return max(round(part.count / max(len(self._resets) - before, 1)), 1)

    def memory(self, episodes: int) -> float:
        """Resident memory after so many further episodes in regular and risky traffic [MiB]."""
        for number in range(episodes):
            self._reset(risk=float(number % 2))
            self._done = False
            while not self._done:
                self._step()
        return resident_mib()


def resident_mib() -> float:
    """Resident memory of this process [MiB] (Linux; elsewhere the peak)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return pages * 4096 / 2**20


def first_step_seconds(backend: str, task: str) -> float:
    """Wall time from the start of a fresh Python to the end of the first step [s]."""
    code = (
        "from experiments.backends import make_env\n"
        f"env = make_env({backend!r}, {task!r}); env.reset(seed=0); env.step(0)"
    )
    start = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
    return time.perf_counter() - start


def training_step_ms(backend: str, task: str, config: Mapping[str, Any], updates: int) -> float:
    """Processor time of an environment step of our training after the warm-up, updates included [ms]."""
    from agents.dqn import DQNConfig
    from agents.training import train

    times: list[float] = []
    settings = DQNConfig(updates=updates, warm_up=200, replay_capacity=STORED)
    train(make_env(backend, task, config), settings, 0, progress=lambda _: times.append(time.process_time()))
    steps = (updates - settings.block) * settings.steps_per_update
    return 1e3 * (times[-1] - times[0]) / steps


class Learners:
    """Updates of our DQN and of Stable-Baselines3's on the same network and batch size, from full replays."""

    def __init__(self, network: str) -> None:
        import torch

        from agents.dqn import DQN, DQNConfig

        torch.set_num_threads(1)
        space, actions = gym.spaces.Box(-1.0, 1.0, (5, 5), np.float32), gym.spaces.Discrete(5)
        config = DQNConfig(network=network, replay_capacity=STORED)
        self._batch = config.batch_size
        self._own = DQN(config, space, actions, 0)
        self._other = stable_baselines(space, actions, config)
        rng = np.random.default_rng(0)
        for _ in range(STORED):
            before, after = rng.uniform(-1.0, 1.0, (2, *space.shape)).astype(np.float32)
            action, reward, end = int(rng.integers(actions.n)), rng.random(), rng.random() < 0.1
            self._own.replay.add(before, action, reward, after, end)
            self._other.replay_buffer.add(
                before[None], after[None], np.array([[action]]), np.array([reward]), np.array([end]), [{}]
            )
        self._own.standardise()

    def own(self, updates: int) -> Slice:
        """So many updates of ours."""
        start = time.process_time()
        for _ in range(updates):
            self._own.update()
        return Slice(updates, time.process_time() - start)

    def other(self, updates: int) -> Slice:
        """So many gradient steps of Stable-Baselines3, which moves its target network elsewhere."""
        start = time.process_time()
        self._other.train(gradient_steps=updates, batch_size=self._batch)
        return Slice(updates, time.process_time() - start)


def stable_baselines(space: gym.spaces.Box, actions: gym.spaces.Discrete, config: Any) -> Any:
    """Stable-Baselines3's DQN with our network inside and our batch size, on an environment that nobody drives."""
    import stable_baselines3
    from stable_baselines3.common.logger import configure
    from stable_baselines3.dqn.policies import DQNPolicy, QNetwork
    from torch import nn

    from agents.models import network_class

    class Policy(DQNPolicy):
        def make_q_net(self) -> QNetwork:
            network = super().make_q_net()
            inner = network_class(config.network)(space, int(actions.n))
            network.q_net = nn.Sequential(nn.Unflatten(1, space.shape), inner)
            return network

    env: gym.Env[Any, Any] = gym.Env()
    env.observation_space, env.action_space = space, actions
    model = stable_baselines3.DQN(
        Policy,
        env,
        learning_rate=config.learning_rate,
        batch_size=config.batch_size,
        buffer_size=config.replay_capacity,
        gamma=config.gamma,
        device="cpu",
        seed=0,
    )
    model.set_logger(configure(None, []))
    return model
