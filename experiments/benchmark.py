"""Speed side by side: the environments against highway-env, the learner against Stable-Baselines3.

    python experiments/benchmark.py --out results/benchmark            # long: two tasks took over 8 minutes
    python experiments/benchmark.py --out /tmp/benchmark --quick       # minutes, less certain

Writes benchmark.json and prints a table for each part. What is compared takes turns in one run, each in a process of
its own and never two at a time, and medians over the turns are taken, because a shared machine is never the same for
long. Rates are in processor time of one core. docs/performance.md says how to read them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import multiprocessing
import os
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing.managers import BaseManager
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from experiments import peers
from experiments.backends import make_env
from experiments.study.grid import BACKENDS, choose_tasks, env_config
from experiments.support.errors import disk_error, run_command, unknown
from experiments.support.files import write_json
from experiments.support.processes import end_with_parent
from experiments.support.provenance import provenance
from sumo_env.tasks import TASKS

SCHEMA = 4
ROOT = Path(__file__).resolve().parents[1]
REFERENCE = "highway-env"
# highway-env's own code alone, whose drivers see beyond the ends of their lanes; 15 Hz is its own frequency.
REFERENCE_CONFIG = {"variant": "connected", "simulation_frequency": 15}
REFERENCE_STEPS = 3  # in a slice, at least
STORED = 10_000  # random transitions in every replay
TURNS, SECONDS = 9, 1.0  # of each comparison; of a slice
QUICK_TURNS, QUICK_SECONDS = 3, 0.2
Record = dict[str, Any]  # a line of a part's table and of benchmark.json


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
        self._done, self._steps = True, 0
        self._resets: list[float] = []
        self.drive(0.0, 2)  # loads the network, compiles, fills caches
        self._resets, self._steps = [], 0

    def _reset(self) -> None:
        start = time.process_time()
        self._env.reset(seed=len(self._resets))
        self._resets.append(time.process_time() - start)

    def drive(self, seconds: float, least: int = 1, whole: bool = True) -> Slice:
        """Take steps for some time.

        whole: to the end of the last episode, so that a slice holds its share of resets; not for simulators in which an
        episode takes too long.
        """
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < least or time.perf_counter() - begun < seconds or (whole and not self._done):
            if self._done:
                self._reset()
            _, _, terminated, truncated, _ = self._env.step(int(self._env.action_space.sample()))
            self._done = terminated or truncated
            steps += 1
        self._steps += steps
        return Slice(steps, time.process_time() - cpu)

    def bare_engine(self, seconds: float) -> Slice:
        """SUMO's own steps with the same vehicles on the road and nobody who reads or commands; counts policy steps.

        It takes as many steps of SUMO as the mean episode so far did, a warm-up included.
        """
        from sumo_env.sumo.session import libsumo  # the only importer of it

        env, usual = self._env.unwrapped, len(self._resets)
        episode = max(round(self._steps / usual), 1)
        frequency = env.config["simulation_frequency"]
        begun, cpu, count = time.perf_counter(), 0.0, 0
        while not count or time.perf_counter() - begun < seconds:
            self._reset()
            steps = round(env.scenario.warm_up * frequency)
            steps += episode * frequency // env.config["policy_frequency"]
            start = time.process_time()
            for _ in range(steps):
                libsumo.simulationStep()
            cpu, count = cpu + time.process_time() - start, count + episode
        self._reset()
        self._done = False
        del self._resets[usual:]  # SUMO's clock has been moved, so that these have loaded the network anew
        return Slice(count, cpu)

    def reset_ms(self) -> float:
        """Median processor time of the resets so far [ms]."""
        return 1e3 * statistics.median(self._resets)


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
        Policy, env, learning_rate=config.learning_rate, buffer_size=config.replay_capacity, device="cpu"
    )
    model.set_logger(configure(None, []))
    return model


def measure_env(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """Steps per second in the lightest and the densest traffic, at highway-env's frequency and at each backend's own.

    Beside highway-env's in turns; of SUMO also as a share of what its own steps alone would reach.
    """
    levels = TASKS[task].levels
    for name in (next(iter(levels)), next(reversed(levels))):
        with ExitStack() as stack:
            theirs = stack.enter_context(
                remote(Driver, REFERENCE, task, {**levels[name], **REFERENCE_CONFIG})
            )
            drivers = {}
            for backend in backends:
                for hertz in sorted({15, int(env_config(backend, task, 1)["simulation_frequency"])}):
                    config = {**levels[name], "simulation_frequency": hertz}
                    drivers[backend, hertz] = stack.enter_context(remote(Driver, backend, task, config))
            slow: list[Slice] = []
            fast: dict[tuple[str, int], list[Slice]] = {key: [] for key in drivers}
            bare: dict[tuple[str, int], list[Slice]] = {key: [] for key in drivers if key[0] == "sumo"}
            for _ in range(turns):
                slow.append(theirs.drive(0.0, REFERENCE_STEPS, False))
                for key, driver in drivers.items():
                    fast[key].append(driver.drive(seconds))
                    if key in bare:
                        bare[key].append(driver.bare_engine(seconds / 2))
            for (backend, hertz), slices in fast.items():
                yield {
                    "of": f"{backend} {hertz} Hz, {task} {name}",
                    "steps_per_second": median_rate(slices),
                    "highway_env": median_rate(slow),
                    "ratio": median_ratio(slices, slow),
                    "reset_ms": drivers[backend, hertz].reset_ms(),
                    "of_bare_engine": median_ratio(slices, bare[backend, hertz])
                    if backend == "sumo"
                    else None,
                }


def measure_start(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """Wall time from the start of a fresh Python to the end of the first step."""
    for backend in backends:
        code = "from experiments.backends import make_env\n"
        code += f"env = make_env({backend!r}, {task!r}); env.reset(seed=0); env.step(0)"
        waited = []
        for _ in range(turns):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
            waited.append(time.perf_counter() - start)
        yield {"of": f"{backend}, {task}", "first_step_seconds": statistics.median(waited)}


def measure_learner(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """Updates per second of ours and of Stable-Baselines3 on the same networks."""
    for network in ("attention", "dueling"):
        slices: dict[str, list[Slice]] = {"own": [], "other": []}
        with remote(Learners, network) as learners:
            for turn in range(turns + 1):
                for side, found in slices.items():
                    part = getattr(learners, side)(round(200 * seconds) if turn else 10)
                    found += [part] if turn else []  # the first turn warms up
        yield {
            "of": network,
            "updates_per_second": median_rate(slices["own"]),
            "stable_baselines3": median_rate(slices["other"]),
            "ratio": median_ratio(slices["own"], slices["other"]),
        }


def measure_peers(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """highway-env, EnvPool's copy of it, the replica and SUMO; a peer that is not installed is skipped."""
    python = Path(os.environ.get("ENVPOOL_PYTHON", sys.executable))
    return peers.measure(task, python, turns, seconds, 100, round(100 * seconds))


# Name of a part -> what measures it, from a task, the backends, turns and seconds of a slice.
PARTS: dict[str, Callable[[str, Sequence[str], int, float], Iterator[Record]]] = {
    "env": measure_env,
    "start": measure_start,
    "learner": measure_learner,
    "peers": measure_peers,
}
WITHOUT_TASK = ("learner",)  # measured once


@dataclass(frozen=True)
class Options:
    """Measure speed side by side."""

    out: Path
    """Directory for benchmark.json."""
    quick: bool = False
    """Fewer and shorter turns."""
    backends: tuple[str, ...] = tuple(name for name in BACKENDS if name != REFERENCE)
    """Environments to compare with highway-env."""
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    parts: tuple[str, ...] = tuple(PARTS)
    """What to measure: env, start, learner, peers (EnvPool by the Python in ENVPOOL_PYTHON)."""


def run(options: Options, console: Console) -> dict[str, Any]:
    """Measure what is asked for, print it, and write benchmark.json after every part; returns its content."""
    effort = (QUICK_TURNS, QUICK_SECONDS) if options.quick else (TURNS, SECONDS)
    tasks = choose_tasks(options.tasks or tuple(TASKS))
    results: dict[str, Any] = {
        "schema": SCHEMA,
        "quick": options.quick,
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "load_average": list(os.getloadavg()),
        "provenance": provenance(),
    }
    for part in options.parts:
        with console.status(part):
            asked = tasks[:1] if part in WITHOUT_TASK else tasks
            results[part] = [row for task in asked for row in PARTS[part](task, options.backends, *effort)]
        write_json(options.out / "benchmark.json", results)
        table = Table(*results[part][0], title=part)
        for row in results[part]:
            shown = (f"{x:.3g}" if isinstance(x, float) else x for x in row.values())
            table.add_row(*("" if x is None else str(x) for x in shown))
        console.print(table)
    return results


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for kind, words, known in (("part", options.parts, PARTS), ("backend", options.backends, BACKENDS)):
        for word in words:
            if word not in known:
                raise unknown(kind, word, known)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        run(options, Console())
    except OSError as error:
        raise disk_error(error, options.out) from None
    return 0


if __name__ == "__main__":
    run_command(main)
