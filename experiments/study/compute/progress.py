"""How long cells will take, and what a person sees of a sweep: a bar, or lines where there is no terminal."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from experiments.study.compute.run import RETRIES, Observer, Task
from experiments.study.design.grid import Cell
from experiments.study.results.working import fraction_done

# Processor seconds of a common server, roughly: for a policy step of each simulator, and for an update of the learner.
STEP = {"sumo": 0.002, "replica": 0.001, "highway-env": 0.15}
UPDATE = 0.0045
LENGTH = 10  # policy steps of an episode
EVERY = 15.0  # [s] between two lines where there is no terminal
MEMORY = 600.0  # [s] over which the speed is averaged


def costs(cell: Cell) -> tuple[float, float]:
    """Expected times of a cell's training and of its tests on one core of a common server [s]."""
    steps, updates = cell.budget
    return updates * UPDATE + steps * STEP[cell.backend], cell.work * LENGTH * STEP[cell.runs_on]


def seconds(cell: Cell) -> float:
    """Expected time of a cell on one core of a common server [s]."""
    return sum(costs(cell))


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


class ProgressDisplay(Observer):
    """Follows tasks.

    Args:
        work: folder of their working folders. costs: expected time of each [s], or another measure of its size.
        finished: tasks that were there before. kind: what they are called.
    """

    def __init__(
        self, work: Path, costs: Mapping[str, float], finished: Collection[str], kind: str = "cells"
    ) -> None:
        self._work, self._costs, self._kind = work, costs, kind
        self._state = {name: "finished" if name in finished else "waiting" for name in costs}
        self._console = Console(highlight=False)
        columns = BarColumn(), TaskProgressColumn(), TimeElapsedColumn(), TimeRemainingColumn()
        self._bars = Progress(
            *columns,
            TextColumn("left"),
            console=self._console,
            disable=not self._console.is_terminal,
            speed_estimate_period=MEMORY,
        )
        self._bar = self._bars.add_task("", total=sum(self._costs.values()), completed=int(self._done()))
        self._bars.start()
        self._shown = time.monotonic()

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A task is in another state now."""
        self._state[task.name] = state
        if words:
            end = f"; given up after {RETRIES} retries" if state == "failed" else ""
            self._console.print(f"{task.name}: {words}{end}", markup=False, soft_wrap=True)

    def tick(self) -> None:
        """Show how much is done; without a terminal, now and then."""
        self._bars.update(self._bar, completed=self._done())
        if not self._console.is_terminal and time.monotonic() - self._shown >= EVERY:
            self._shown = time.monotonic()
            counts, bar = Counter(self._state.values()), self._bars.tasks[0]
            parts = [f"{counts.pop('finished', 0)}/{len(self._state)} {self._kind}", f"{bar.percentage:.0f}%"]
            if left := bar.time_remaining:
                parts.append(f"about {duration(left)} left")
            print(", ".join([*parts, *(f"{number} {state}" for state, number in counts.items())]), flush=True)

    def close(self) -> None:
        """Leave the screen in order."""
        self._shown = -EVERY
        self.tick()
        self._bars.stop()

    def _done(self) -> float:
        """Expected time of what is done [s]."""
        part = {"finished": 1.0, "failed": 1.0}
        return sum(
            cost * (fraction_done(self._work / name) if state == "running" else part.get(state, 0.0))
            for (name, state), cost in zip(self._state.items(), self._costs.values(), strict=True)
        )
