"""Speed side by side: the environments against highway-env, the learner against Stable-Baselines3.

    python experiments/benchmark.py --out results/benchmark            # long: two tasks took over 8 minutes
    python experiments/benchmark.py --out /tmp/benchmark --quick       # minutes, less certain

Writes benchmark.json and prints one table. What is compared takes turns in one run, and medians over the turns are
taken, because a shared machine is never the same for long. Rates are in processor time of one core.
docs/performance.md says how to read them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import os
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from experiments import peers
from experiments.measuring import (
    Driver,
    Learners,
    Slice,
    first_step_seconds,
    median_rate,
    median_ratio,
    remote,
    training_step_ms,
)
from experiments.study.grid import BACKENDS, choose_tasks, env_config, level_names
from experiments.support.errors import disk_error, run_command, unknown
from experiments.support.files import write_json
from experiments.support.provenance import provenance
from sumo_env.tasks import TASKS

SCHEMA = 3
REFERENCE = "highway-env"
# highway-env's own code alone, whose drivers see beyond the ends of their lanes; 15 Hz is its own frequency.
REFERENCE_CONFIG = {"variant": "connected", "simulation_frequency": 15}
# One line of the table and of benchmark.json: measured (what), of (which), ours, theirs, ratio, note, and more values.
Record = dict[str, Any]


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    turns: int
    seconds: float  # of a slice
    reference_steps: int  # in a slice of highway-env, at least
    middle_levels: bool
    starts: int
    updates: int  # of the learners in a slice; of a training four times as many
    episodes: int  # over which memory is watched
    peer_episodes: int  # of each constant policy


FULL = Effort(
    turns=9,
    seconds=1.0,
    reference_steps=4,
    middle_levels=True,
    starts=5,
    updates=200,
    episodes=4000,
    peer_episodes=100,
)
QUICK = Effort(
    turns=3,
    seconds=0.2,
    reference_steps=2,
    middle_levels=False,
    starts=1,
    updates=40,
    episodes=200,
    peer_episodes=20,
)


def measure_env(task: str, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """Steps per second of each backend at highway-env's frequency and at its own, beside highway-env's in turns."""
    names = level_names(task)
    for level in range(1, len(names) + 1):
        if level in (1, len(names)) or (effort.middle_levels and task == "highway"):
            yield from _measure_level(task, level, backends, effort)


def _measure_level(task: str, level: int, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    name = level_names(task)[level - 1]
    config = TASKS[task].levels[name]
    with ExitStack() as stack:
        theirs = stack.enter_context(remote(Driver, REFERENCE, task, {**config, **REFERENCE_CONFIG}))
        drivers = {}
        for backend in backends:
            for hertz in sorted({15, int(env_config(backend, task, level)["simulation_frequency"])}):
                own = {**config, "simulation_frequency": hertz}
                drivers[backend, hertz] = stack.enter_context(remote(Driver, backend, task, own))
        slow: list[Slice] = []
        fast: dict[tuple[str, int], list[Slice]] = {key: [] for key in drivers}
        bare: dict[tuple[str, int], list[Slice]] = {key: [] for key in drivers if key[0] == "sumo"}
        lengths = {key: drivers[key].episode_steps() for key in bare}
        for _ in range(effort.turns):
            slow.append(theirs.drive(0.0, effort.reference_steps, False))
            for key, driver in drivers.items():
                fast[key].append(driver.drive(effort.seconds))
                if key in bare:
                    bare[key].append(driver.bare_engine(effort.seconds / 2, lengths[key]))
        for (backend, hertz), slices in fast.items():
            reset = drivers[backend, hertz].reset_ms()
            share = median_ratio(slices, bare[backend, hertz]) if (backend, hertz) in bare else None
            yield {
                "measured": "steps per second",
                "of": f"{backend} {hertz} Hz, {task} {name}",
                "ours": median_rate(slices),
                "theirs": median_rate(slow),
                "ratio": median_ratio(slices, slow),
                "note": f"reset {reset:.2g} ms" + (f"; {share:.2f} of the bare engine" if share else ""),
                "reset_ms": reset,
                "of_bare_engine": share,
            }


def measure_start(task: str, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """Wall time to the end of the first step in a fresh process."""
    for backend in backends:
        seconds = statistics.median(first_step_seconds(backend, task) for _ in range(effort.starts))
        yield {
            "measured": "first step [s]",
            "of": f"{backend}, {task}",
            "ours": seconds,
            "note": "fresh process",
        }


def measure_learner(task: str, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """Updates per second of ours and of Stable-Baselines3 on the same networks."""
    for network in ("attention", "dueling"):
        with remote(Learners, network) as learners:
            slices: dict[str, list[Slice]] = {"own": [], "other": []}
            for turn in range(effort.turns + 1):
                for side, found in slices.items():
                    part = getattr(learners, side)(effort.updates if turn else 10)
                    found += [part] if turn else []  # the first turn warms up
        yield {
            "measured": "updates per second",
            "of": network,
            "ours": median_rate(slices["own"]),
            "theirs": median_rate(slices["other"]),
            "ratio": median_ratio(slices["own"], slices["other"]),
            "note": "Stable-Baselines3",
        }


def measure_training(task: str, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """An environment step of a whole training at the lowest level."""
    config = next(iter(TASKS[task].levels.values()))
    for backend in backends:
        step = training_step_ms(backend, task, config, 4 * effort.updates)
        yield {"measured": "training, ms per step", "of": f"{backend}, {task}", "ours": step}


def measure_memory(task: str, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """Resident memory over the episodes, and its growth once it has settled."""
    part = effort.episodes // 10
    for backend in backends:
        with remote(Driver, backend, task, {}) as driver:
            resident = [driver.memory(part) for _ in range(10)]
        growth = 1e3 * (resident[-1] - resident[1]) / (8 * part)
        yield {
            "measured": "memory [MiB]",
            "of": f"{backend}, {task}",
            "ours": resident[-1],
            "note": f"{growth:.2g} MiB per 1000 episodes",
        }


def measure_peers(task: str, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """highway-env, EnvPool's copy of it, the replica and SUMO; a peer that is not installed is left out."""
    python = Path(os.environ.get("ENVPOOL_PYTHON", sys.executable))
    return peers.measure(task, python, effort.turns, effort.seconds, 100, effort.peer_episodes)


# Name of a part -> what measures it, from a task, the backends and the effort.
PARTS: dict[str, Callable[[str, Sequence[str], Effort], Iterator[Record]]] = {
    "env": measure_env,
    "start": measure_start,
    "learner": measure_learner,
    "training": measure_training,
    "memory": measure_memory,
    "peers": measure_peers,
}
WITHOUT_TASK = ("learner",)  # measured once


@dataclass(frozen=True)
class Options:
    """Measure speed side by side."""

    out: Path
    """Directory for benchmark.json."""
    quick: bool = False
    """Fewer turns, the lowest and the highest level of each task."""
    backends: tuple[str, ...] = tuple(name for name in BACKENDS if name != REFERENCE)
    """Environments to compare with highway-env."""
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    parts: tuple[str, ...] = tuple(PARTS)
    """What to measure: env, start, learner, training, memory, peers (EnvPool by the Python in ENVPOOL_PYTHON)."""


def run(options: Options, console: Console) -> dict[str, Any]:
    """Measure what is asked for and write benchmark.json after every part; returns its content."""
    effort = QUICK if options.quick else FULL
    tasks = choose_tasks(options.tasks or tuple(TASKS))
    results: dict[str, Any] = {
        "schema": SCHEMA,
        "quick": options.quick,
        "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "load_average": list(os.getloadavg()),
        "provenance": provenance(),
    }
    with console.status("") as status:
        for part in options.parts:
            results[part] = []
            for task in tasks[:1] if part in WITHOUT_TASK else tasks:
                status.update(f"{part} {'' if part in WITHOUT_TASK else task}")
                results[part] += PARTS[part](task, options.backends, effort)
            write_json(options.out / "benchmark.json", results)
    return results


def show(results: dict[str, Any], console: Console) -> None:
    """Everything measured in one table."""

    def number(value: float | None) -> str:
        return "" if value is None else f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"

    table = Table("measured", "of", "ours", "theirs", "ratio", "")
    for record in (record for part in PARTS for record in results.get(part, ())):
        values = (number(record.get(name)) for name in ("ours", "theirs", "ratio"))
        table.add_row(record["measured"], record["of"], *values, record.get("note", ""))
    console.print(table)


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for kind, words, known in (("part", options.parts, PARTS), ("backend", options.backends, BACKENDS)):
        for word in words:
            if word not in known:
                raise unknown(kind, word, known)
    console = Console()
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        results = run(options, console)
    except OSError as error:
        raise disk_error(error, options.out) from None
    show(results, console)
    console.print(f"{options.out / 'benchmark.json'}")
    return 0


if __name__ == "__main__":
    run_command(main)
