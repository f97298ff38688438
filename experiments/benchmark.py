"""Speed side by side: the environments against highway-env and EnvPool.

    python experiments/benchmark.py --out results/benchmark            # long: two tasks took over 8 minutes
    python experiments/benchmark.py --out results/benchmark --quick       # minutes, less certain

Writes benchmark.json and prints a table for each part. The programs take turns, one process at a time, because a shared
machine is never equally fast for long. Medians over the turns are taken. Rates are in processor time of one core.
docs/performance.md says how to read them.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import get_context
from multiprocessing.managers import BaseManager
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
import pandas as pd

from experiments.backends import make_env
from experiments.study.design.levels import choose_tasks
from experiments.support.arguments import argument, command
from experiments.support.errors import writing
from experiments.support.files import write_json
from experiments.support.provenance import provenance
from sumo_env.tasks import TASKS

SCHEMA = 8
# highway-env's own code alone, whose drivers see beyond the ends of their lanes; 15 Hz is its own frequency.
REFERENCE_CONFIG = {"variant": "connected", "simulation_frequency": 15}
BACKENDS = {"sumo": (10, 15), "replica": (15,)}  # and the frequencies that they are driven at [Hz]
LEAST = 3  # steps in a slice
SEEDS = 100  # whose first observations are compared
BATCH = 64  # environments
TURNS, SECONDS = 9, 1.0  # of each comparison; of a slice
QUICK_TURNS, QUICK_SECONDS = 3, 0.2
Record = dict[str, Any]  # a line of a part's table and of benchmark.json


class Driver:
    """Drives an environment, or a batch, with random actions, as an exploring agent does: resets count in full.

    Args:
        backend: of the study, or "envpool".
        config: of the study's environment; None for the default configuration of the backend's own, and for EnvPool.
        batch: environments of EnvPool, or of the replica in seeded scenarios, that a step drives; None for one.
        threads: that drive them.
    """

    def __init__(
        self,
        backend: str,
        task: str,
        config: dict[str, Any] | None = None,
        batch: int | None = None,
        threads: int = 1,
    ) -> None:
        self._env: Any
        self._envpool: dict[str, Any] = {}
        if backend == "envpool":
            batch = batch or 1
            self._envpool = {"task_id": f"{task}-v0", "num_envs": batch, "num_threads": threads}
        elif batch:
            settings: dict[str, Any] = {"scenarios": "seeded", "config": config, "threads": threads}
            self._env = gym.make_vec(gym.spec(f"replica/{task}-v0"), num_envs=batch, **settings)
        elif config is not None:
            self._env = make_env(backend, task, config)
        else:
            is_theirs = backend == "highway-env"
            self._env = gym.make(f"highway_env:{task}-v0" if is_theirs else gym.spec(f"{backend}/{task}-v0"))
        self._rng = np.random.default_rng(0)
        self._batch = batch
        # a slice ends with an episode and so holds its share of resets; batches begin the next episodes by themselves,
        # and highway-env's episodes take too long
        self._whole = not batch and backend != "highway-env"
        self._done = False
        self._resets: list[float] = []  # processor time of each [s]
        self._begin(0)
        space: Any = getattr(self._env, "single_action_space", self._env.action_space)
        self._actions = int(space.n)
        self.rate(0.0)  # loads the network, compiles, fills caches
        self._resets = []

    def _begin(self, seed: int) -> Any:
        """Begin the episode of a seed; returns the first observation."""
        if not self._envpool:
            return self._env.reset(seed=seed)[0]
        import envpool

        self._env = envpool.make_gymnasium(**self._envpool, seed=seed)  # which cannot be told later
        return self._env.reset()[0]

    def rate(self, seconds: float) -> tuple[float, float]:
        """Policy steps per second of processor time and of wall time, in a slice of so many seconds."""
        begun, cpu, steps = time.perf_counter(), time.process_time(), 0
        while steps < LEAST or time.perf_counter() - begun < seconds or (self._whole and not self._done):
            if self._done:
                start = time.process_time()
                self._env.reset()
                self._resets.append(time.process_time() - start)
            actions = self._rng.integers(self._actions, size=self._batch).astype("int32")
            _, _, terminated, truncated, _ = self._env.step(actions)
            self._done = not self._batch and (terminated or truncated)
            steps += 1
        steps *= self._batch or 1
        return steps / (time.process_time() - cpu), steps / (time.perf_counter() - begun)

    def reset_ms(self) -> float | None:
        """Median processor time of the resets so far [ms], if there were any."""
        return 1e3 * statistics.median(self._resets) if self._resets else None

    def distinct(self, seeds: int) -> int:
        """Different first observations of so many seeds."""
        return len({self._begin(seed).tobytes() for seed in range(seeds)})


class Process(BaseManager):
    """A process for objects of this file: its method `Driver` makes one there."""

    Driver: Any


Process.register("Driver", Driver)


def ratios(rates: pd.DataFrame) -> list[Record]:
    """Each side (a column): the median of its rate over the turns (rows), and of its ratio to the first side's."""
    relative = rates.div(rates.iloc[:, 0], axis="index")
    medians = {"steps_per_second": rates.median(), "ratio": relative.median()}
    return pd.DataFrame(medians).rename_axis("of").reset_index().to_dict("records")


def in_turns(
    sides: Mapping[str, tuple[Any, ...]], turns: int, seconds: float, clock: str = "processor"
) -> Iterator[tuple[Driver, Record]]:
    """Drivers in turns, each in a process that ends afterwards, with its line.

    Args:
        sides: by name the arguments of `Driver`; the others are compared with the first.
        clock: "processor" or "wall".
    """
    with ExitStack() as stack:
        drivers = {
            side: stack.enter_context(Process(ctx=get_context("spawn"))).Driver(*arguments)
            for side, arguments in sides.items()
        }
        rates = pd.DataFrame(
            {side: driver.rate(seconds)[clock == "wall"] for side, driver in drivers.items()}
            for _ in range(turns)
        )
        yield from zip(drivers.values(), ratios(rates), strict=True)


def has_envpool() -> bool:
    """Whether EnvPool can be measured."""
    return find_spec("envpool") is not None


def measure_env(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """Steps per second in the lightest and the densest traffic, at highway-env's frequency and at SUMO's own."""
    levels = TASKS[task].levels
    for name in (next(iter(levels)), next(reversed(levels))):
        of = f"{task} {name}"
        sides = {f"highway-env, {of}": ("highway-env", task, {**levels[name], **REFERENCE_CONFIG})}
        for backend, frequencies in BACKENDS.items():
            for hertz in frequencies:
                config = {**levels[name], "simulation_frequency": hertz}
                sides[f"{backend} {hertz} Hz, {of}"] = backend, task, config
        for driver, line in in_turns(sides, turns, seconds):
            yield {**line, "reset_ms": driver.reset_ms()}


def measure_peers(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """highway-env, EnvPool's copy of it, the replica and SUMO as they come; EnvPool is left out if it is missing.

    `distinct` is the number of different first observations of SEEDS seeds.
    """
    names = ["highway-env", *(["envpool"] if has_envpool() else []), "replica", "sumo"]
    for driver, line in in_turns({f"{name}, {task}": (name, task) for name in names}, turns, seconds):
        yield {**line, "distinct": driver.distinct(SEEDS)}


def measure_batches(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """64 environments of the replica in one call, compared with 64 of EnvPool if it is installed.

    Then, in wall time, on two threads compared with one. EnvPool drives its default configuration.
    """
    levels = TASKS[task].levels
    for name in ("default", next(iter(levels)), next(reversed(levels))):
        of, config = f"{task} {name}", levels.get(name, {})
        peer = {f"envpool, {of}": ("envpool", task, None, BATCH)} if has_envpool() else {}
        one = {f"replica, {of}": ("replica", task, config, BATCH)}
        two = {f"replica on two threads (wall time), {of}": ("replica", task, config, BATCH, 2)}
        yield from (line for _, line in in_turns(peer | one, turns, seconds))
        yield [line for _, line in in_turns(one | two, turns, seconds, "wall")][-1]


# Name of a part -> what measures it, from a task, turns and seconds of a slice.
PARTS: dict[str, Callable[[str, int, float], Iterator[Record]]] = {
    "env": measure_env,
    "peers": measure_peers,
    "batches": measure_batches,
}


@dataclass(frozen=True)
class Options:
    """Measure speed side by side."""

    out: Path
    """Directory for benchmark.json."""
    quick: bool = False
    """Fewer and shorter turns."""
    tasks: Annotated[tuple[str, ...], argument("TASK ...", "those of the study")] = ()
    """Which tasks."""
    parts: tuple[Literal["env", "peers", "batches"], ...] = ("env", "peers", "batches")
    """What to measure (the last two with EnvPool where it is installed)."""


def run(options: Options) -> dict[str, Any]:
    """Measure what is asked for, print it, and write benchmark.json after every part; returns its content."""
    effort = (QUICK_TURNS, QUICK_SECONDS) if options.quick else (TURNS, SECONDS)
    tasks = choose_tasks(options.tasks)
    results: dict[str, Any] = {
        "schema": SCHEMA,
        "quick": options.quick,
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "load_average": list(os.getloadavg()),
        "provenance": provenance(),
    }
    if not has_envpool():
        print("EnvPool is left out: pip install envpool", file=sys.stderr)
    with writing(options.out):
        for part in options.parts:
            print(part, flush=True)
            results[part] = [line for task in tasks for line in PARTS[part](task, *effort)]
            write_json(options.out / "benchmark.json", results)
            print(pd.DataFrame(results[part]).to_string(index=False, float_format="{:.3g}".format, na_rep=""))
    return results


def main(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    run(options)
    return 0


if __name__ == "__main__":
    command(main, Options, __doc__)
