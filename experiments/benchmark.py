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

import os
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from experiments.backends import BACKENDS
from experiments.study.grid import choose_tasks, env_config
from experiments.support.errors import run_command, unknown, writing
from experiments.support.files import write_json
from experiments.support.provenance import provenance
from experiments.timed import ROOT, WITH_LANES, Process
from sumo_env.tasks import TASKS

SCHEMA = 4
REFERENCE = "highway-env"
# highway-env's own code alone, whose drivers see beyond the ends of their lanes; 15 Hz is its own frequency.
REFERENCE_CONFIG = {"variant": "connected", "simulation_frequency": 15}
PEERS = (REFERENCE, "envpool", "replica", "sumo")
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


def beside(ours: Sequence[float], theirs: Sequence[float], unit: str, other: str) -> Record:
    """Medians over the turns of both rates, and of their ratio."""
    rates = {unit: statistics.median(ours), other: statistics.median(theirs)}
    return {**rates, "ratio": median_ratio(ours, theirs)}


def driver(stack: ExitStack, *arguments: Any, python: str = sys.executable) -> Process:
    """A `timed.Driver` in a process that ends with the stack."""
    return stack.enter_context(closing(Process("Driver", *arguments, python=python)))


def measure_env(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """Steps per second in the lightest and the densest traffic, at highway-env's frequency and at each backend's own.

    Beside highway-env's in turns; of SUMO also as a share of what its own steps alone would reach.
    """
    levels = TASKS[task].levels
    for name in (next(iter(levels)), next(reversed(levels))):
        with ExitStack() as stack:
            theirs = driver(stack, REFERENCE, task, {**levels[name], **REFERENCE_CONFIG})
            sides: dict[Any, Callable[[], float]] = {REFERENCE: partial(theirs.ask, "rate", 0.0)}
            drivers = {}
            for backend in backends:
                for hertz in sorted({15, int(env_config(backend, task, 1)["simulation_frequency"])}):
                    config = {**levels[name], "simulation_frequency": hertz}
                    own = drivers[backend, hertz] = driver(stack, backend, task, config)
                    sides[backend, hertz] = partial(own.ask, "rate", seconds)
                    if backend == "sumo":
                        sides["bare", hertz] = partial(own.ask, "bare_engine", seconds / 2)
            rates = in_turns(sides, turns)
            for (backend, hertz), own in drivers.items():
                bare = rates.get(("bare", hertz)) if backend == "sumo" else None
                yield {
                    "of": f"{backend} {hertz} Hz, {task} {name}",
                    **beside(rates[backend, hertz], rates[REFERENCE], "steps_per_second", "highway_env"),
                    "reset_ms": own.ask("reset_ms"),
                    "of_bare_engine": bare and median_ratio(rates[backend, hertz], bare),
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
        with closing(Process("Learners", network)) as learners:
            sides = {side: partial(learners.ask, side, round(200 * seconds)) for side in ("own", "other")}
            rates = in_turns(sides, turns)
        yield {
            "of": network,
            **beside(rates["own"], rates["other"], "updates_per_second", "stable_baselines3"),
        }


def measure_peers(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """highway-env, EnvPool's copy of it, the replica and SUMO as they come; EnvPool is left out if it is missing.

    `distinct` is the number of different first observations of SEEDS seeds, `crash_rates` are those of the constant
    policies.
    """
    python = os.environ.get("ENVPOOL_PYTHON", sys.executable)
    pythons = {name: python if name == "envpool" else sys.executable for name in PEERS}
    if subprocess.run([python, "-c", "import envpool"], capture_output=True).returncode:
        print(f"EnvPool is left out: {python} has none (ENVPOOL_PYTHON names a Python)", file=sys.stderr)
        del pythons["envpool"]
    with ExitStack() as stack:
        peers = {name: driver(stack, name, task, python=path) for name, path in pythons.items()}
        rates = in_turns({name: partial(peer.ask, "rate", seconds) for name, peer in peers.items()}, turns)
        for name, peer in peers.items():
            yield {
                "of": f"{name}, {task}",
                **beside(rates[name], rates[REFERENCE], "steps_per_second", "highway_env"),
                "distinct": peer.ask("distinct", SEEDS),
                "crash_rates": {
                    policy: peer.ask("crash_rate", policy, round(100 * seconds)) for policy in WITH_LANES
                },
            }


def measure_batches(task: str, backends: Sequence[str], turns: int, seconds: float) -> Iterator[Record]:
    """64 environments of the replica in one call, beside 64 of EnvPool if it is there, and on two threads.

    EnvPool drives its default configuration. `two_threads` is their rate over that of one, in wall time.
    """
    python, levels = os.environ.get("ENVPOOL_PYTHON", sys.executable), TASKS[task].levels
    batches = [("replica", 1), ("replica", 2), ("envpool", 1)]
    if subprocess.run([python, "-c", "import envpool"], capture_output=True).returncode:
        batches.pop()
    for name in ("default", next(iter(levels)), next(reversed(levels))):
        sides: dict[Any, Callable[[], Any]] = {}
        with ExitStack() as stack:
            for backend, threads in batches:
                path = python if backend == "envpool" else sys.executable
                process = Process("Batch", backend, task, levels.get(name, {}), threads, python=path)
                sides[backend, threads] = partial(stack.enter_context(closing(process)).ask, "rate", seconds)
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


# Name of a part -> what measures it, from a task, the backends, turns and seconds of a slice.
PARTS: dict[str, Callable[[str, Sequence[str], int, float], Iterator[Record]]] = {
    "env": measure_env,
    "start": measure_start,
    "learner": measure_learner,
    "peers": measure_peers,
    "batches": measure_batches,
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
    with writing(options.out):
        run(options, Console())
    return 0


if __name__ == "__main__":
    run_command(main)
