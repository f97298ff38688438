"""Measure speed side by side: SUMO against highway-env, the learner against Stable-Baselines3.

    python experiments/benchmark.py --out results/benchmark            # about a quarter of an hour
    python experiments/benchmark.py --out /tmp/benchmark --quick       # two minutes, less certain

Writes benchmark.json and benchmark.html. What is compared takes turns in one run, and the medians over the turns
are taken, because a shared machine is never the same for long. Rates are in processor time of one core unless
they are called wall time. docs/performance.md says how to read them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from experiments.benchmarks import environments, scaling, targets, throughput
from experiments.benchmarks.sizes import FULL, QUICK, Size
from experiments.benchmarks.targets import Target
from experiments.study.estimate import duration
from experiments.study.grid import choose_tasks, level_names
from experiments.support.errors import disk_error, run_command, unknown
from experiments.support.files import write_file, write_json
from experiments.support.provenance import provenance
from sumo_env.tasks import TASKS

SCHEMA = 1
PARTS = ("env", "learner", "sweep", "vector", "growth", "memory")
Note = Callable[[str], None]


@dataclass(frozen=True)
class Options:
    """Measure speed side by side: SUMO against highway-env, the learner against Stable-Baselines3."""

    out: Path
    """Directory for benchmark.json and benchmark.html."""
    quick: bool = False
    """Two minutes: fewer turns, the lowest and the highest level of each task."""
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    parts: tuple[str, ...] = PARTS
    """What to measure: env, learner, sweep, vector, growth, memory."""


def levels_of(task: str, every: bool) -> list[int]:
    """Numbers of the levels to measure: on the highway all in a full run, else the lowest and the highest."""
    last = len(level_names(task))
    return list(range(1, last + 1)) if every and task == "highway" else [1, last]


def parts(options: Options, size: Size) -> dict[str, Callable[[Note], Any]]:
    """What is to be measured, in this order: name -> function that measures it.

    Raises:
        UserError: a task or part that does not exist.
    """
    tasks = choose_tasks(options.tasks or tuple(TASKS))
    for part in options.parts:
        if part not in size.seconds:
            raise unknown("part", part, size.seconds)

    def env(note: Note) -> list[Any]:
        return [
            record
            for task in tasks
            for record in environments.measure_task(task, levels_of(task, size.all_levels), size.effort, note)
        ]

    def sweep(note: Note) -> list[Any]:
        places = [
            (task, level)
            for task in tasks
            for level in (range(1, len(level_names(task)) + 1) if size.all_levels else levels_of(task, False))
        ]
        return throughput.measure_sweep(places, (1, 2), size.sweep_updates, size.sweep_episodes, note)

    def vector(note: Note) -> list[Any]:
        chosen = [task for task in size.vector_tasks if task in tasks]
        return scaling.measure_vector(chosen, size.vector_sizes, size.vector_seconds, note)

    def learner(note: Note) -> list[Any]:
        # Not at the top: torch takes seconds to import, and each measuring process imports this file.
        from experiments.benchmarks.learner import measure_learner

        return measure_learner(size.learner_turns, note)

    functions: dict[str, Callable[[Note], Any]] = {
        "env": env,
        "learner": learner,
        "sweep": sweep,
        "vector": vector,
        "growth": lambda note: scaling.measure_growth(size.growth, size.effort, note),
        "memory": lambda note: scaling.measure_memory(size.memory, note),
    }
    return {name: functions[name] for name in size.seconds if name in options.parts}


def run(options: Options) -> int:
    """Measure, write both files, print the summary; returns the exit status."""
    size = QUICK if options.quick else FULL
    todo = parts(options, size)
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        start = time.monotonic()
        results: dict[str, Any] = {
            "schema": SCHEMA,
            "quick": options.quick,
            "started": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            "load_average": list(os.getloadavg()),
            "provenance": provenance(),
        }
        with Watch({name: size.seconds[name] for name in todo}) as watch:
            for name, function in todo.items():
                watch.begin(name)
                results[name] = function(watch.note)
        results["seconds"] = time.monotonic() - start
        goals = targets.compare(results)
        results["targets"] = [goal.as_dict() for goal in goals]
        write_json(options.out / "benchmark.json", results)
        from experiments.benchmarks import page  # draws with matplotlib, which takes as long to import

        write_file(options.out / "benchmark.html", page.render(results).encode())
    except OSError as error:
        raise disk_error(error, options.out) from None
    summary(goals)
    print(f"{options.out / 'benchmark.json'}, {options.out / 'benchmark.html'}")
    return 0


class Watch:
    """Shows which part is being measured, and the time left by what the parts are expected to take.

    Args:
        seconds: expected time of each part; the time left is scaled by how wrong it has been so far.
    """

    def __init__(self, seconds: Mapping[str, float]) -> None:
        self._seconds = dict(seconds)
        self._total = sum(seconds.values())
        self._done = self._expected = 0.0  # expected seconds of the finished parts, of the running one
        self._begun = self._start = time.monotonic()
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[left]}"),
            disable=not sys.stdout.isatty(),
        )  # fmt: skip
        self._task = self._bar.add_task("", total=self._total, left="")

    def begin(self, part: str) -> None:
        """The next part begins."""
        self._done += self._expected
        self._expected = self._seconds[part]
        self._begun = time.monotonic()
        if self._bar.disable:
            print(f"{part}, about {duration(self._left())} left", flush=True)

    def note(self, text: str) -> None:
        """Show what is being done."""
        within = min(time.monotonic() - self._begun, 0.95 * self._expected)
        left = f"about {duration(self._left())} left"
        self._bar.update(self._task, completed=self._done + within, description=text, left=left)

    def _left(self) -> float:
        elapsed = time.monotonic() - self._start
        within = min(time.monotonic() - self._begun, self._expected)
        done = self._done + within
        pace = elapsed / done if done > 0.05 * self._total else 1.0
        return (self._total - done) * pace

    def __enter__(self) -> Watch:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()


def summary(goals: Sequence[Target]) -> None:
    """Print the targets that were measured, beside what was measured."""
    table = Table(box=None, padding=(0, 2, 0, 0))
    table.add_column("", no_wrap=True)
    for name in ("target", "measured"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for goal in goals:
        if goal.measured is not None:
            sign = "<= " if goal.at_most else ""
            verdict = "met" if goal.met else "missed"
            table.add_row(goal.name, f"{sign}{goal.wanted:g}", targets.number(goal.measured), verdict)
    if table.row_count:
        Console().print(table)
    if left := len(goals) - table.row_count:
        print(f"{left} targets belong to what was not measured.")


def main() -> int:
    """The command line."""
    return run(tyro.cli(Options, description=__doc__))


if __name__ == "__main__":
    run_command(main)
