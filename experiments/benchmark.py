"""Speed side by side: the environments against highway-env and EnvPool, and the time of the learner.

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

import os
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from experiments.study.grid import choose_tasks
from experiments.support.errors import run_command, unknown, writing
from experiments.support.files import write_json
from experiments.support.provenance import provenance
from experiments.timed import ROOT, Process
from sumo_env.tasks import TASKS

SCHEMA = 5
REFERENCE = "highway-env"
# highway-env's own code alone, whose drivers see beyond the ends of their lanes; 15 Hz is its own frequency.
REFERENCE_CONFIG = {"variant": "connected", "simulation_frequency": 15}
BACKENDS = {"sumo": (10, 15), "replica": (15,)}  # and the frequencies that they are driven at [Hz]
ENVPOOL = os.environ.get("ENVPOOL_PYTHON", sys.executable)  # a Python that has it, in case
STORED = 10_000  # random transitions in the learner's replay
SEEDS = 100  # whose first observations are compared
TURNS, SECONDS = 9, 1.0  # of each comparison; of a slice
QUICK_TURNS, QUICK_SECONDS = 3, 0.2
Record = dict[str, Any]  # a line of a part's table and of benchmark.json


def in_turns(sides: Mapping[Any, Callable[[], float]], turns: int) -> dict[Any, list[float]]:
    """The rate of each side in every turn."""
    measured = [{side: measure() for side, measure in sides.items()} for _ in range(turns)]
    return {side: [turn[side] for turn in measured] for side in sides}


def median_ratio(ours: Sequence[float], theirs: Sequence[float]) -> float:
    """Median over the turns of our rate over theirs."""
    return statistics.median(a / b for a, b in zip(ours, theirs, strict=True))


def beside(ours: Sequence[float], theirs: Sequence[float]) -> Record:
    """Medians over the turns of our rate, highway-env's, and of their ratio."""
    rates = {"steps_per_second": statistics.median(ours), "highway_env": statistics.median(theirs)}
    return {**rates, "ratio": median_ratio(ours, theirs)}


def opened(stack: ExitStack, kind: str, backend: str, *arguments: Any) -> Process:
    """An object of `timed` in a process that ends with the stack."""
    python = ENVPOOL if backend == "envpool" else sys.executable
    return stack.enter_context(closing(Process(kind, backend, *arguments, python=python)))


def has_envpool() -> bool:
    """Whether EnvPool can be measured."""
    return not subprocess.run([ENVPOOL, "-c", "import envpool"], capture_output=True).returncode


def measure_env(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """Steps per second in the lightest and the densest traffic, at highway-env's frequency and at SUMO's own."""
    levels = TASKS[task].levels
    for name in (next(iter(levels)), next(reversed(levels))):
        with ExitStack() as stack:
            configs = {(REFERENCE, 15): {**levels[name], **REFERENCE_CONFIG}}
            for backend, frequencies in BACKENDS.items():
                for hertz in frequencies:
                    configs[backend, hertz] = {**levels[name], "simulation_frequency": hertz}
            drivers = {
                side: opened(stack, "Driver", side[0], task, config) for side, config in configs.items()
            }
            sides = {side: partial(each.ask, "rate", seconds) for side, each in drivers.items()}
            sides[REFERENCE, 15] = partial(drivers[REFERENCE, 15].ask, "rate", 0.0)  # a few steps take long
            rates = in_turns(sides, turns)
            for (backend, hertz), own in list(drivers.items())[1:]:
                yield {
                    "of": f"{backend} {hertz} Hz, {task} {name}",
                    **beside(rates[backend, hertz], rates[REFERENCE, 15]),
                    "reset_ms": own.ask("reset_ms"),
                }


def measure_start(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """Wall time from the start of a fresh Python to the end of the first step."""
    for backend in BACKENDS:
        code = "from experiments.backends import make_env\n"
        code += f"env = make_env({backend!r}, {task!r}); env.reset(seed=0); env.step(0)"
        waited = []
        for _ in range(turns):
            start = time.perf_counter()
            subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
            waited.append(time.perf_counter() - start)
        yield {"of": f"{backend}, {task}", "first_step_seconds": statistics.median(waited)}


def measure_learner(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """Processor time of an update by each network, on random transitions; the same for all tasks."""
    from agents.dqn import DQN, DQNConfig

    rng = np.random.default_rng(0)
    for network in ("attention", "dueling"):
        config = DQNConfig(network=network, replay_capacity=STORED)
        learner = DQN(config, gym.spaces.Box(-1.0, 1.0, (5, 5)), gym.spaces.Discrete(5), 0)
        for _ in range(STORED):
            before, after = rng.uniform(-1.0, 1.0, (2, 5, 5)).astype(np.float32)
            learner.replay.add(before, int(rng.integers(5)), rng.random(), after, rng.random() < 0.1)
        learner.standardise()
        spent, count = [], round(200 * seconds)
        for _ in range(turns):
            start = time.process_time()
            for _ in range(count):
                learner.update()
            spent.append((time.process_time() - start) / count)
        yield {"of": f"{network}, batch {config.batch_size}", "update_ms": 1e3 * statistics.median(spent)}


def measure_peers(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """highway-env, EnvPool's copy of it, the replica and SUMO as they come; EnvPool is left out if it is missing.

    `distinct` is the number of different first observations of SEEDS seeds, `idle_crash_rate` that of always IDLE.
    """
    names = [REFERENCE, *(["envpool"] if has_envpool() else []), "replica", "sumo"]
    if "envpool" not in names:
        print(f"EnvPool is left out: {ENVPOOL} has none (ENVPOOL_PYTHON names a Python)", file=sys.stderr)
    with ExitStack() as stack:
        peers = {name: opened(stack, "Driver", name, task) for name in names}
        rates = in_turns({name: partial(peer.ask, "rate", seconds) for name, peer in peers.items()}, turns)
        for name, peer in peers.items():
            yield {
                "of": f"{name}, {task}",
                **beside(rates[name], rates[REFERENCE]),
                "distinct": peer.ask("distinct", SEEDS),
                "idle_crash_rate": peer.ask("idle_crash_rate", round(100 * seconds)),
            }


def measure_batches(task: str, turns: int, seconds: float) -> Iterator[Record]:
    """64 environments of the replica in one call, beside 64 of EnvPool if it is there, and on two threads.

    EnvPool drives its default configuration. `two_threads` is their rate over that of one, in wall time.
    """
    levels = TASKS[task].levels
    batches = [("replica", 1), ("replica", 2), *([("envpool", 1)] if has_envpool() else [])]
    for name in ("default", next(iter(levels)), next(reversed(levels))):
        with ExitStack() as stack:
            sides: dict[Any, Callable[[], Any]] = {
                side: partial(
                    opened(stack, "Batch", side[0], task, levels.get(name, {}), side[1]).ask, "rate", seconds
                )
                for side in batches
            }
            rates: Any = in_turns(sides, turns)
        cpu, wall = ({side: [pair[k] for pair in pairs] for side, pairs in rates.items()} for k in (0, 1))
        own, theirs = cpu["replica", 1], cpu.get(("envpool", 1))
        yield {
            "of": f"{task} {name}",
            "steps_per_second": statistics.median(own),
            "envpool": theirs and statistics.median(theirs),
            "ratio": theirs and median_ratio(own, theirs),
            "two_threads": median_ratio(wall["replica", 2], wall["replica", 1]),
        }


# Name of a part -> what measures it, from a task, turns and seconds of a slice.
PARTS: dict[str, Callable[[str, int, float], Iterator[Record]]] = {
    "env": measure_env,
    "start": measure_start,
    "learner": measure_learner,
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
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    parts: tuple[str, ...] = tuple(PARTS)
    """What to measure: env, start, learner, peers, batches (EnvPool by the Python in ENVPOOL_PYTHON)."""


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
            asked = tasks[:1] if part == "learner" else tasks
            results[part] = [row for task in asked for row in PARTS[part](task, *effort)]
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
    for part in options.parts:
        if part not in PARTS:
            raise unknown("part", part, PARTS)
    with writing(options.out):
        run(options, Console())
    return 0


if __name__ == "__main__":
    run_command(main)
