"""Speed side by side: the environments against highway-env, the learner against Stable-Baselines3.

    python experiments/benchmark.py --out results/benchmark            # long: two tasks took over 8 minutes
    python experiments/benchmark.py --out /tmp/benchmark --quick       # minutes, less certain

Writes benchmark.json and prints one table. What is compared takes turns in one run, and medians over the turns are
taken, because a shared machine is never the same for long. Rates are in processor time of one core unless they are
called wall time. docs/performance.md says how to read them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import os
import statistics
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from experiments.measuring import (
    Driver,
    Learners,
    Remote,
    Slice,
    Trainee,
    first_step_seconds,
    median_rate,
    median_ratio,
)
from experiments.study.grid import BACKENDS, choose_tasks, env_config, level_names
from experiments.support.errors import disk_error, run_command, unknown
from experiments.support.files import write_json
from experiments.support.provenance import provenance
from sumo_env.tasks import TASKS

SCHEMA = 2
PARTS = ("env", "start", "learner", "training", "memory")
REFERENCE = "highway-env"
# highway-env's own code alone, whose drivers see beyond the ends of their lanes; 15 Hz is its own frequency.
REFERENCE_CONFIG = {"variant": "connected", "simulation_frequency": 15}
Record = dict[str, Any]


@dataclass(frozen=True)
class Effort:
    """How much is measured."""

    turns: int
    seconds: float  # of a slice
    reference_steps: int  # in a slice of highway-env, at least
    middle_levels: bool
    starts: int
    updates: int  # of the learners in a slice, and of a training
    episodes: int  # over which memory is watched


FULL = Effort(
    turns=9, seconds=1.0, reference_steps=4, middle_levels=True, starts=5, updates=200, episodes=4000
)
QUICK = Effort(
    turns=3, seconds=0.2, reference_steps=2, middle_levels=False, starts=1, updates=40, episodes=200
)


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
    parts: tuple[str, ...] = PARTS
    """What to measure: env, start, learner, training, memory."""


def measure_env(task: str, level: int, backends: Sequence[str], effort: Effort) -> Iterator[Record]:
    """Steps per second of each backend at highway-env's frequency and at its own, beside highway-env's in turns."""
    config = TASKS[task].levels[level_names(task)[level - 1]]
    with ExitStack() as stack:
        theirs = stack.enter_context(Remote(Driver, REFERENCE, task, {**config, **REFERENCE_CONFIG}))
        drivers = {
            (backend, frequency): stack.enter_context(
                Remote(Driver, backend, task, {**config, "simulation_frequency": frequency})
            )
            for backend in backends
            for frequency in dict.fromkeys(
                (15, int(env_config(backend, task, level)["simulation_frequency"]))
            )
        }
        slow: list[Slice] = []
        fast: dict[tuple[str, int], list[Slice]] = {key: [] for key in drivers}
        bare: dict[tuple[str, int], list[Slice]] = {key: [] for key in drivers if key[0] == "sumo"}
        lengths = {key: drivers[key].call("episode_steps") for key in bare}
        for _ in range(effort.turns):
            slow.append(theirs.call("steps", effort.reference_steps))
            for key, driver in drivers.items():
                fast[key].append(driver.call("drive", effort.seconds))
                if key in bare:
                    bare[key].append(driver.call("bare_engine", effort.seconds / 2, lengths[key]))
        for key, driver in drivers.items():
            yield {
                "task": task, "level": level_names(task)[level - 1], "backend": key[0], "frequency": key[1],
                "ratio": median_ratio(fast[key], slow), "steps_per_s": median_rate(fast[key]),
                "highway_env_steps_per_s": median_rate(slow),
                "wall_steps_per_s": statistics.median(part.count / part.wall for part in fast[key]),
                "of_bare_engine": median_ratio(fast[key], bare[key]) if key in bare else None,
                "reset_ms": driver.call("reset_ms"), "highway_env_reset_ms": theirs.call("reset_ms"),
            }  # fmt: skip


def measure_learner(effort: Effort) -> list[Record]:
    """Updates per second of ours and of Stable-Baselines3 on the same networks."""
    records = []
    for network in ("attention", "dueling"):
        with Remote(Learners, network) as learners:
            for side in ("own", "other"):
                learners.call(side, 10)
            own, other = [], []
            for _ in range(effort.turns):
                own.append(learners.call("own", effort.updates))
                other.append(learners.call("other", effort.updates))
        records.append(
            {"network": network, "updates_per_s": median_rate(own), "sb3_updates_per_s": median_rate(other),
             "ratio": median_ratio(own, other)}
        )  # fmt: skip
    return records


def measure_training(tasks: Sequence[str], backends: Sequence[str], effort: Effort) -> list[Record]:
    """An environment step of a whole training: ours on each backend, Stable-Baselines3's on highway-env."""
    records = []
    for task in tasks:
        config = next(iter(TASKS[task].levels.values()))
        with Remote(Trainee, REFERENCE, task, {**config, **REFERENCE_CONFIG}) as trainee:
            theirs = trainee.call("other", 2 * effort.reference_steps * effort.turns, 200)
        for backend in backends:
            with Remote(Trainee, backend, task, config) as trainee:
                own = trainee.call("own", 4 * effort.updates, 200)
            records.append({"task": task, "backend": backend, **own, "sb3_on_highway_env_ms": theirs,
                            "ratio": theirs / own["step_ms"]})  # fmt: skip
    return records


def measure_memory(task: str, backend: str, effort: Effort) -> Record:
    """Resident memory over the episodes, and its growth once it has settled."""
    part = effort.episodes // 10
    with Remote(Driver, backend, task, {}) as driver:
        resident = [driver.call("memory", part) for _ in range(10)]
    growth = (resident[-1] - resident[1]) / (8 * part)
    return {"task": task, "backend": backend, "episodes": 10 * part, "mib": resident[-1],
            "mib_per_1000_episodes": 1e3 * growth}  # fmt: skip


def run(options: Options, console: Console) -> Record:
    """Measure what is asked for and write benchmark.json after every part; returns its content."""
    effort = QUICK if options.quick else FULL
    tasks = choose_tasks(options.tasks or tuple(TASKS))
    results: Record = {
        "schema": SCHEMA, "quick": options.quick, "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "load_average": list(os.getloadavg()), "provenance": provenance(),
    }  # fmt: skip
    with console.status("") as status:
        for part in options.parts:
            found: list[Record] = []
            for task in tasks if part != "learner" else ("",):
                status.update(f"{part} {task}")
                last = len(level_names(task)) if task else 0
                if part == "env":
                    levels = range(1, last + 1) if effort.middle_levels and task == "highway" else (1, last)
                    for level in levels:
                        found += measure_env(task, level, options.backends, effort)
                elif part == "start":
                    for backend in options.backends:
                        times = [first_step_seconds(backend, task) for _ in range(effort.starts)]
                        found.append({"task": task, "backend": backend, "seconds": statistics.median(times)})
                elif part == "learner":
                    found += measure_learner(effort)
                elif part == "training":
                    found += measure_training((task,), options.backends, effort)
                else:
                    found += [measure_memory(task, backend, effort) for backend in options.backends]
            results[part] = found
            write_json(options.out / "benchmark.json", results)
    return results


def number(value: float | None) -> str:
    """Three significant digits, without an exponent."""
    if value is None:
        return ""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def show(results: Record, console: Console) -> None:
    """Everything measured in one table."""
    table = Table("measured", "", "ours", "theirs", "ratio", "")
    for r in results.get("env", ()):
        bare = f"; {number(r['of_bare_engine'])} of the bare engine" if r["of_bare_engine"] else ""
        table.add_row(
            "steps per second", f"{r['backend']} {r['frequency']} Hz, {r['task']} {r['level']}",
            number(r["steps_per_s"]), number(r["highway_env_steps_per_s"]), number(r["ratio"]),
            f"reset {number(r['reset_ms'])} ms{bare}",
        )  # fmt: skip
    for r in results.get("start", ()):
        table.add_row(
            "first step [s]", f"{r['backend']}, {r['task']}", number(r["seconds"]), "", "", "fresh process"
        )
    for r in results.get("learner", ()):
        values = map(number, (r["updates_per_s"], r["sb3_updates_per_s"], r["ratio"]))
        table.add_row("updates per second", r["network"], *values, "Stable-Baselines3")
    for r in results.get("training", ()):
        values = map(number, (r["step_ms"], r["sb3_on_highway_env_ms"], r["ratio"]))
        note = f"{number(r['env_ms'])} ms in the environment"
        table.add_row("training, ms per step", f"{r['backend']}, {r['task']}", *values, note)
    for r in results.get("memory", ()):
        note = f"{number(r['mib_per_1000_episodes'])} MiB per 1000 episodes"
        table.add_row("memory [MiB]", f"{r['backend']}, {r['task']}", number(r["mib"]), "", "", note)
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
