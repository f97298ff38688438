"""How long cells will take, and what a person sees of a sweep: a bar that moves, or lines where there is no terminal.

Everything that happens is also written to DIR/sweep.log, one line each, which can be followed with `tail -f` wherever
the sweep runs.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bars

from experiments.study.grid import Cell
from experiments.study.run import RETRIES, Observer, Task, fraction_done
from experiments.study.store import Store

# Processor seconds of a common server for a policy step in the lightest traffic; rough except for SUMO.
STEP: dict[str, dict[str, float]] = {
    "sumo": {"highway": 0.0025, "two-way": 0.0010, "roundabout": 0.0016, "intersection": 0.0020},
    "replica": {"highway": 0.0008},
    "highway-env": {
        "highway": 0.4,
        "two-way": 0.04,
        "roundabout": 0.07,
        "intersection": 0.09,
        "u-turn": 0.03,
    },
}
OTHERWISE = 0.001  # [s]
LENGTH = 10  # policy steps of an episode
UPDATE = 0.005  # [s] of the learner, without the steps
CELL = 0.5  # [s] beside training and test: environment, files
GROWTH = 0.25  # how much longer each heavier level takes
BAR_EVERY, LINE_EVERY, LOG_EVERY = 2.0, 15.0, 300.0  # [s]
MEMORY = 600.0  # [s] over which the speed is averaged
LOG = "sweep.log"


def seconds(cell: Cell) -> float:
    """Expected time of a cell on one core of a common server [s]."""
    step = (1.0 + GROWTH * (cell.level - 1)) * STEP[cell.runs_on].get(cell.task, OTHERWISE)
    update = UPDATE + cell.profile.get("steps_per_update", 1) * step
    return CELL + cell.updates * update + cell.work * LENGTH * step


def duration(seconds: float) -> str:
    """A time span as a person says it: "40 s", "12 min", "3 h 20 min"."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


class Progress(Observer):
    """Follows the cells of a sweep, and notes those that fail.

    Args:
        finished: names of the cells that were there before.
        command: computes one cell, whose name is to be appended.
    """

    def __init__(self, store: Store, cells: Sequence[Cell], finished: set[str], command: str) -> None:
        self._store, self._command = store, command
        self._costs = {cell.name: seconds(cell) for cell in cells}
        self._state = {name: "finished" if name in finished else "waiting" for name in self._costs}
        self._shown = self._logged = time.monotonic()
        self._console = Console(highlight=False)
        self._bars = Bars(
            *(
                BarColumn(),
                TaskProgressColumn(),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                TextColumn("left"),
            ),
            console=self._console,
            disable=not self._console.is_terminal,
            speed_estimate_period=MEMORY,
        )
        self._bar = self._bars.add_task("", total=sum(self._costs.values()), completed=self._done())
        self._bars.start()
        self._log(f"{len(cells)} cells, {len(finished)} of them finished before")

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A cell is in another state now."""
        self._state[task.name] = state
        if state == "failed":
            with suppress(OSError):  # on a full disk the report says that the cell is missing
                self._store.write_failure(task.name, words, f"{self._command} {task.name}")
            words += f"; given up after {RETRIES} retries"
        if words:
            self._console.print(f"{task.name}: {words}", markup=False, soft_wrap=True)
        self._log(f"{task.name} {state}{words and f': {words}'}")

    def tick(self) -> None:
        """Show it."""
        now = time.monotonic()
        if now - self._shown >= (BAR_EVERY if self._console.is_terminal else LINE_EVERY):
            self._shown = now
            self._show()
        if now - self._logged >= LOG_EVERY:
            self._logged = now
            self._log(self.summary())

    def close(self) -> None:
        """Leave the screen in order, and the last state in the log."""
        self._show()
        self._bars.stop()
        self._log(self.summary())

    def summary(self) -> str:
        """All of it in one line."""
        counts, bar = Counter(self._state.values()), self._bars.tasks[0]
        parts = [f"{counts.pop('finished', 0)}/{len(self._state)} cells", f"{bar.percentage:.0f}%"]
        if left := bar.time_remaining:
            parts.append(f"about {duration(left)} left")
        return ", ".join([*parts, *(f"{number} {state}" for state, number in counts.items())])

    def _done(self) -> float:
        """Expected time of what is done of the cells [s]."""
        part = {"finished": 1.0, "failed": 1.0, "waiting": 0.0, "in another run": 0.0}
        return sum(
            self._costs[name] * part.get(state, fraction_done(self._store.work / name))
            for name, state in self._state.items()
        )

    def _show(self) -> None:
        self._bars.update(self._bar, completed=self._done())
        if not self._console.is_terminal:
            print(self.summary(), flush=True)

    def _log(self, text: str) -> None:
        with suppress(OSError), (self._store.directory / LOG).open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
