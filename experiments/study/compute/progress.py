"""How long cells will take, and what a person sees of a sweep: a line of how much is done."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Collection, Mapping
from pathlib import Path

from experiments.study.compute.run import Observer, Task
from experiments.study.design.grid import Cell
from experiments.study.results.working import fraction_done

# Processor seconds of a common server, roughly: for a policy step of each simulator, and for an update of the learner.
STEP = {"sumo": 0.002, "replica": 0.001, "highway-env": 0.15}
UPDATE, COMPILED = 0.0045, 0.0025
LENGTH = 10  # policy steps of an episode
EVERY = 15.0  # [s] between two lines where there is no terminal


def costs(cell: Cell) -> tuple[float, float]:
    """Expected times of a cell's training and of its tests on one core of a common server [s]."""
    steps, updates = cell.budget
    update = COMPILED if cell.is_compiled else UPDATE
    return updates * update + steps * STEP[cell.backend], cell.work * LENGTH * STEP[cell.runs_on]


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
    """Follows tasks: on a terminal in one line that changes, elsewhere in a new one now and then.

    Args:
        work: folder of their working folders. costs: expected time of each [s], or another measure of its size.
        finished: tasks that were there before. kind: what they are called.
    """

    def __init__(
        self, work: Path, costs: Mapping[str, float], finished: Collection[str], kind: str = "cells"
    ) -> None:
        self._work, self._costs, self._kind = work, costs, kind
        self._state = {name: "finished" if name in finished else "waiting" for name in costs}
        self._shown = time.monotonic()
        self._begun: float | None = None  # when the first of it was done: processes take a while to start
        self._before = self._done()
        self._over = "\r\x1b[K" if sys.stdout.isatty() else ""  # writes over the line that is there

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A task is in another state now."""
        self._state[task.name] = state
        if words:
            print(f"{self._over}{task.name}: {words}", flush=True)

    def tick(self) -> None:
        """Show how much is done; without a terminal, now and then."""
        if self._begun is None and (done := self._done()) > self._before:
            self._begun, self._before = time.monotonic(), done
        if self._over:
            print(self._over + self._line(), end="", flush=True)
        elif time.monotonic() - self._shown >= EVERY:
            self._shown = time.monotonic()
            print(self._line(), flush=True)

    def close(self) -> None:
        """Show what has come of it."""
        print(self._over + self._line(), flush=True)

    def _line(self) -> str:
        done, total, counts = self._done(), sum(self._costs.values()), Counter(self._state.values())
        parts = [f"{counts.pop('finished', 0)}/{len(self._state)} {self._kind}"]
        if total:
            parts.append(f"{100 * done / total:.0f}%")
        if self._begun is not None and done > self._before:
            speed = (done - self._before) / (time.monotonic() - self._begun)
            parts.append(f"about {duration((total - done) / speed)} left")
        return ", ".join([*parts, *(f"{number} {state}" for state, number in counts.items())])

    def _done(self) -> float:
        """Expected time of what is done [s]."""
        part = {"finished": 1.0, "failed": 1.0}
        return sum(
            cost * (fraction_done(self._work / name) if state == "running" else part.get(state, 0.0))
            for (name, state), cost in zip(self._state.items(), self._costs.values(), strict=True)
        )
