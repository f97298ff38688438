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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from experiments.backends import make_env
from experiments.support.processes import end_with_parent
from experiments.support.threads import limit_threads

ROOT = Path(__file__).resolve().parents[1]
STORED = 10_000  # random transitions in every replay


@dataclass(frozen=True)
class Slice:
    """A stretch of work: how much of it, in which wall and processor time [s]."""

    count: int
    wall: float
    cpu: float

    @property
    def per_second(self) -> float:
        """Rate in processor time: what one core does, whoever else uses the machine."""
        return self.count / self.cpu


class Stopwatch:
    """Wall and processor time of this process since the start."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    @property
    def wall(self) -> float:
        """[s]."""
        return time.perf_counter() - self._wall

    def slice(self, count: int) -> Slice:
        """The stretch up to now."""
        return Slice(count, self.wall, time.process_time() - self._cpu)


class Remote:
    """An object in a spawned process: ``remote.call("method", ...)`` returns what the method returns.

    Args:
        factory: makes the object, in the process; an importable class.
        arguments: its arguments.
    """

    def __init__(self, factory: Callable[..., Any], *arguments: Any) -> None:
        limit_threads()  # inherited by the process, which imports numpy before anything of ours runs
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, initializer=_make, initargs=(factory, arguments))

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the object and wait for its result; what it raises is raised here."""
        return self._pool.submit(_call, method, arguments).result()

    def __enter__(self) -> Remote:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()


_objects: list[Any] = []  # the one object of a `Remote`'s process


def _make(factory: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    end_with_parent()
    _objects.append(factory(*arguments))


def _call(method: str, arguments: tuple[Any, ...]) -> Any:
    return getattr(_objects[0], method)(*arguments)


def median_ratio(ours: Sequence[Slice], theirs: Sequence[Slice]) -> float:
    """Median over the turns of our rate over theirs."""
    return statistics.median(a.per_second / b.per_second for a, b in zip(ours, theirs, strict=True))


def median_rate(slices: Sequence[Slice]) -> float:
    """Median over the turns of what one second of processor time brings."""
    return statistics.median(part.per_second for part in slices)


class Driver:
    """Drives one environment with random actions, as an exploring agent does: resets count in full."""

    def __init__(self, backend: str, task: str, config: Mapping[str, Any]) -> None:
        self._env: Any = make_env(backend, task, config)
        space = self._env.action_space
        assert isinstance(space, gym.spaces.Discrete)
        self._actions = _random_actions(int(space.n))
        self._seed, self._done = 0, True
        self._resets: list[float] = []
        self.drive(0.0, 2)  # loads the network, compiles, fills caches
        self._resets.clear()

    def drive(self, seconds: float, least: int = 1) -> Slice:
        """Take steps for some time, to the end of the last episode, so that a slice holds its share of resets."""
        watch, steps = Stopwatch(), 0
        while steps < least or watch.wall < seconds or not self._done:
            if self._done:
                self._reset()
            _, _, terminated, truncated, _ = self._env.step(next(self._actions))
            self._done = terminated or truncated
            steps += 1
        return watch.slice(steps)

    def steps(self, least: int) -> Slice:
        """Take some steps, however the episode stands: for simulators in which an episode takes too long."""
        watch = Stopwatch()
        for _ in range(least):
            if self._done:
                self._reset()
            _, _, terminated, truncated, _ = self._env.step(next(self._actions))
            self._done = terminated or truncated
        return watch.slice(least)

    def bare_engine(self, seconds: float, episode: int) -> Slice:
        """SUMO's own steps with the same vehicles on the road and nobody who reads or commands; counts policy steps.

        It takes as many steps of SUMO as an episode of this length does, a warm-up included.
        """
        from sumo_env.contacts.measures import TTC_RADIUS
        from sumo_env.sumo.session import libsumo  # the only importer of it

        env = self._env.unwrapped
        frequency = env.config["simulation_frequency"]
        steps = episode * frequency // env.config["policy_frequency"]
        wall = cpu = 0.0
        count = 0
        usual = len(self._resets)
        while not count or wall < seconds:
            self._reset()
            libsumo.vehicle.unsubscribeContext("ego", libsumo.CMD_GET_VEHICLE_VARIABLE, TTC_RADIUS)
            warm_up = round(env.scenario.warm_up * frequency)
            watch = Stopwatch()
            for _ in range(warm_up + steps):
                libsumo.simulationStep()
            part = watch.slice(episode)
            wall, cpu, count = wall + part.wall, cpu + part.cpu, count + part.count
        self._reset()
        del self._resets[usual:]  # SUMO's clock has been moved, so that these have loaded the network anew
        return Slice(count, wall, cpu)

    def _reset(self) -> None:
        start = time.process_time()
        self._env.reset(seed=self._seed)
        self._resets.append(time.process_time() - start)
        self._seed += 1
        self._done = False

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
            self._env.reset(seed=self._seed, options={"config": {"risk": float(number % 2)}})
            self._seed += 1
            ended = False
            while not ended:
                _, _, terminated, truncated, _ = self._env.step(next(self._actions))
                ended = terminated or truncated
        return resident_mib()


def _random_actions(count: int) -> Iterator[int]:
    """Uniform ones of so many actions; drawn in blocks, to take no time of the loop."""
    rng = np.random.default_rng(0)
    while True:
        yield from rng.integers(count, size=4096).tolist()


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


class SpacesOnly(gym.Env[Any, Any]):
    """An environment that knows its spaces; nobody drives it."""

    def __init__(self, space: gym.spaces.Box, actions: gym.spaces.Discrete) -> None:
        self.observation_space, self.action_space = space, actions

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:
        """Stable-Baselines3 looks at the first observation."""
        return np.zeros(self.observation_space.shape or (), np.float32), {}


class Timed(gym.Wrapper[Any, Any, Any, Any]):
    """Counts the steps and adds up the processor time inside of an environment [s]."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.steps, self.inside = 0, 0.0

    def reset(self, **arguments: Any) -> Any:
        """Begin an episode."""
        start = time.process_time()
        result = self.env.reset(**arguments)
        self.inside += time.process_time() - start
        return result

    def step(self, action: Any) -> Any:
        """Take a step."""
        start = time.process_time()
        result = self.env.step(action)
        self.inside += time.process_time() - start
        self.steps += 1
        return result


class Learners:
    """Updates of our DQN and of Stable-Baselines3's on the same network and batch size, from full replays."""

    def __init__(self, network: str) -> None:
        import torch

        from agents.dqn import DQN, DQNConfig

        torch.set_num_threads(1)
        self._space, actions = gym.spaces.Box(-1.0, 1.0, (5, 5), np.float32), gym.spaces.Discrete(5)
        config = DQNConfig(network=network, replay_capacity=STORED)
        self._batch = config.batch_size
        self._own = DQN(config, self._space, actions, 0)
        self._other = stable_baselines(SpacesOnly(self._space, actions), config, STORED)
        rng = np.random.default_rng(0)
        for _ in range(STORED):
            before, after = rng.uniform(-1.0, 1.0, (2, *self._space.shape)).astype(np.float32)
            action, reward, end = int(rng.integers(actions.n)), rng.random(), rng.random() < 0.1
            self._own.replay.add(before, action, reward, after, end)
            self._other.replay_buffer.add(
                before[None], after[None], np.array([[action]]), np.array([reward]), np.array([end]), [{}]
            )
        self._own.standardise()

    def own(self, updates: int) -> Slice:
        """So many updates of ours."""
        watch = Stopwatch()
        for _ in range(updates):
            self._own.update()
        return watch.slice(updates)

    def other(self, updates: int) -> Slice:
        """So many gradient steps of Stable-Baselines3, which moves its target network elsewhere."""
        watch = Stopwatch()
        self._other.train(gradient_steps=updates, batch_size=self._batch)
        return watch.slice(updates)


def stable_baselines(env: Any, config: Any, capacity: int) -> Any:
    """Stable-Baselines3's DQN with our network inside, our batch size and our number of steps per update."""
    import stable_baselines3
    from stable_baselines3.common.logger import configure
    from stable_baselines3.dqn.policies import DQNPolicy, QNetwork
    from torch import nn

    from agents.models import network_class

    space, actions = env.observation_space, int(env.action_space.n)

    class Policy(DQNPolicy):
        def make_q_net(self) -> QNetwork:
            network = super().make_q_net()
            inner = network_class(config.network)(space, actions)
            network.q_net = nn.Sequential(nn.Unflatten(1, space.shape), inner)
            return network

    model = stable_baselines3.DQN(
        Policy, env, learning_rate=config.learning_rate, batch_size=config.batch_size, buffer_size=capacity,
        gamma=config.gamma, learning_starts=config.warm_up, train_freq=config.steps_per_update, device="cpu", seed=0,
        tau=config.tau, target_update_interval=config.steps_per_update * config.target_interval,
    )  # fmt: skip
    model.set_logger(configure(None, []))
    return model


class Trainee:
    """One agent in training on one backend, ours or Stable-Baselines3's, measured step by step after the warm-up."""

    def __init__(self, backend: str, task: str, config: Mapping[str, Any]) -> None:
        import torch

        torch.set_num_threads(1)
        self._env: Any = make_env(backend, task, config)

    def own(self, updates: int, warm_up: int) -> dict[str, float]:
        """Processor time of an environment step of our training, all included, and the environment's share [ms]."""
        from agents.dqn import DQNConfig
        from agents.training import train

        timed = Timed(self._env)
        marks: list[tuple[int, float, float]] = []

        def mark(_: Any) -> None:
            marks.append((timed.steps, timed.inside, time.process_time()))

        config = DQNConfig(updates=updates, warm_up=warm_up, replay_capacity=STORED)
        train(timed, config, 0, progress=mark)
        (first, _, begin), (last, _, end) = marks[0], marks[-1]
        steps = max(last - first, 1)
        return {"step_ms": 1e3 * (end - begin) / steps, "env_ms": 1e3 * (marks[-1][1] - marks[0][1]) / steps}

    def other(self, steps: int, warm_up: int) -> float:
        """The same of Stable-Baselines3's training, after its warm-up [ms]."""
        from agents.dqn import DQNConfig

        model = stable_baselines(self._env, DQNConfig(warm_up=warm_up), STORED)
        model.learn(warm_up)
        start = time.process_time()
        model.learn(steps, reset_num_timesteps=False)
        return 1e3 * (time.process_time() - start) / steps
