"""How long cells will take, and what a person sees of a sweep: a line of how much is done."""

import shutil
import sys
import time
from collections import Counter, deque
from collections.abc import Collection, Mapping
from pathlib import Path

from experiments.study.compute.run import Observer, Task
from experiments.study.design.cell import Cell
from experiments.study.results.working import fraction_done

# Processor seconds of a common server, roughly: for a policy step of each simulator, and for an update of the learner.
STEP = {"sumo": 0.002, "replica": 0.001, "highway-env": 0.15}
PLANNING = 0.15  # for a step of a planner, who drives copies
UPDATE, COMPILED = 0.0045, 0.0025
LENGTH = 10  # policy steps of an episode whose configuration has no duration
EVERY = 15.0  # [s] between two lines where there is no terminal
WINDOW = 600.0  # [s] of which the speed is taken


def step_cost(policy: str, simulator: str) -> float:
    """Expected time of a policy step on one core of a common server [s]."""
    return PLANNING if policy in ("planner", "clairvoyant") else STEP[simulator]


def costs(cell: Cell) -> tuple[float, float]:
    """Expected times of a cell's training and of its tests on one core of a common server [s]."""
    steps, updates = cell.budget
    update = COMPILED if cell.kind == "agent" and "numba" in cell.versions else UPDATE
    length = cell.env_config.get("duration", LENGTH)
    tests = cell.work * length * step_cost(cell.policy, cell.runs_on)
    return updates * update + steps * STEP[cell.backend], tests


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


class ProgressDisplay(Observer):
    """Follows tasks: on a terminal in one line that changes, elsewhere in a new one now and then.

    The time that is left follows from what this run has done itself in the last ten minutes.

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
        self._others = set(finished)  # tasks that say nothing about this run's speed
        self._seen: deque[tuple[float, float]] = deque()  # when, and what was done by then [s]

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A task is in another state now."""
        self._state[task.name] = state
        if state in ("in another run", "failed") and task.name not in self._others:
            self._others.add(task.name)
            self._seen.clear()
        if words:
            self._over()
            print(f"{task.name}: {words}", flush=True)

    def tick(self) -> None:
        """Show how much is done; without a terminal, now and then."""
        now, done = time.monotonic(), self._done(self._costs.keys() - self._others)
        if done:  # processes take a while to start
            self._seen.append((now, done))
            while now - self._seen[0][0] > WINDOW:
                self._seen.popleft()
        if self._over():  # a line that the terminal breaks in two could not be begun again
            print(self._line()[: shutil.get_terminal_size().columns - 1], end="", flush=True)
        elif now - self._shown >= EVERY:
            self._shown = now
            print(self._line(), flush=True)

    def close(self) -> None:
        """Show what has come of it."""
        self._over()
        print(self._line(), flush=True)

    def _over(self) -> bool:
        """Begin the line again, if this is a terminal; returns whether it is one."""
        return bool(sys.stdout and sys.stdout.isatty() and sys.stdout.write("\r\x1b[K"))

    def _line(self) -> str:
        done, total, counts = self._done(), sum(self._costs.values()), Counter(self._state.values())
        parts = [f"{counts.pop('finished', 0)}/{len(self._state)} {self._kind}"]
        if total:
            parts.append(f"{100 * done / total:.0f}%")
        if self._seen:
            (then, before), (now, own) = self._seen[0], self._seen[-1]
            if own > before:
                parts.append(f"about {duration((total - done) * (now - then) / (own - before))} left")
        return ", ".join([*parts, *(f"{number} {state}" for state, number in counts.items())])

    def _done(self, names: Collection[str] | None = None) -> float:
        """Expected time of what is done of these tasks, or of all [s]."""
        part = {"finished": 1.0, "failed": 1.0}
        return sum(
            cost * (fraction_done(self._work / name) if state == "running" else part.get(state, 0.0))
            for (name, state), cost in zip(self._state.items(), self._costs.values(), strict=True)
            if names is None or name in names
        )
