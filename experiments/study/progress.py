"""How long cells will take, and what a person sees of a sweep: a bar that moves, or a line where there is no terminal.

Everything that happens is also written to DIR/sweep.log, one line each, which can be followed with `tail -f` wherever
the sweep runs. Times are of a common server; while a sweep runs, they are scaled by how fast it is.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from experiments.study.grid import Cell
from experiments.study.run import RETRIES, Observer, Sign, Task
from experiments.study.store import Store

# Processor seconds of a common server for (a training step, a test episode) in the lightest traffic;
# rough except for SUMO.
RATES: dict[str, dict[str, tuple[float, float]]] = {
    "sumo": {
        "highway": (0.0025, 0.050),
        "two-way": (0.0010, 0.010),
        "roundabout": (0.0016, 0.017),
        "intersection": (0.0020, 0.017),
        "u-turn": (0.0011, 0.010),
    },
    "replica": {"highway": (0.0008, 0.015)},
    "highway-env": {
        "highway": (0.400, 6.000),
        "two-way": (0.040, 0.300),
        "roundabout": (0.070, 0.600),
        "intersection": (0.090, 0.900),
        "u-turn": (0.030, 0.300),
    },
}
OTHERWISE = (0.0006, 0.005)
UPDATE = 0.005  # [s] of the learner, without the steps
CELL = 0.5  # [s] beside training and test: environment, files
START = 20.0  # [s] of a sweep: starting the processes, and the report
SHOW_EVERY = 2.0  # [s] between looks at all cells
LINE_EVERY, LOG_EVERY = 15.0, 300.0  # [s] between lines where nobody watches, and in the log
TRUST_AFTER = 60.0  # [s] from when on the speed of this run counts, and not its number of workers
LOG = "sweep.log"
GROWTH = 0.25  # how much longer each heavier level takes


def seconds(cell: Cell) -> float:
    """Expected time of a cell on one core of a common server [s], without what a sweep takes once (START)."""
    factor = 1.0 + GROWTH * (cell.level - 1)
    step, episode = (factor * rate for rate in RATES[cell.runs_on].get(cell.task, OTHERWISE))
    update = UPDATE + cell.profile.get("steps_per_update", 1) * step
    return CELL + cell.updates * update + cell.work * episode


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
        self.workers = 1  # how many cells are computed at a time
        self._cells = {cell.name: cell for cell in cells}
        self._state = {name: "finished" if name in finished else "waiting" for name in self._cells}
        self._costs = {cell.name: seconds(cell) for cell in cells}
        self._store, self._command = store, command
        self._fractions: dict[str, float] = {}  # of running cells
        self._done_here = 0.0  # estimated core time of what this run finished [s]
        self._start = self._logged = time.monotonic()
        self._shown = self._start - LINE_EVERY
        self._console = Console(highlight=False)
        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeElapsedColumn())
        self._bars = Bars(*columns, console=self._console, disable=not self._console.is_terminal)
        self._bar = self._bars.add_task("", total=1.0)
        self._bars.start()
        self._log(f"{len(cells)} cells, {len(finished)} of them finished before")

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A cell is in another state now."""
        self._state[task.name] = state
        self._fractions.pop(task.name, None)
        if state == "running":
            self._log(f"{task.name} started")
        elif state == "finished":
            self._done_here += self._costs[task.name]
            self._log(f"{task.name} finished")
        elif state == "failed":
            with suppress(OSError):  # on a full disk the report says that the cell is missing
                self._store.write_failure(task.name, words, f"{self._command} {task.name}")
            words += f"; given up after {RETRIES} retries"
        if words:
            self._console.print(f"{task.name}: {words}", markup=False, soft_wrap=True)
            self._log(f"{task.name}: {words}")

    def tick(self, running: Mapping[str, Sign | None]) -> None:
        """Show it."""
        self._fractions = {name: sign.fraction for name, sign in running.items() if sign is not None}
        now = time.monotonic()
        if now - self._shown >= (SHOW_EVERY if self._console.is_terminal else LINE_EVERY):
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
        counts = Counter(self._state.values())
        share, left = self._look()
        parts = [f"{counts.pop('finished', 0)}/{len(self._cells)} cells", f"{share:.0%}"]
        if left:
            parts.append(f"about {duration(left)} left")
        parts += [f"{number} {state}" for state, number in counts.items() if state != "running"]
        running = [self._cells[name].slug for name, state in self._state.items() if state == "running"]
        more = f" and {len(running) - 4} more" if len(running) > 4 else ""
        if running:
            parts.append(f"running {', '.join(running[:4])}{more}")
        return ", ".join(parts)

    def _look(self) -> tuple[float, float]:
        """Share of the work that is done, and expected time until the rest is [s]."""
        costs, part = self._costs, {"finished": 1.0, "failed": 1.0}
        done = {name: part.get(state, self._fractions.get(name, 0.0)) for name, state in self._state.items()}
        left = [costs[name] * (1.0 - share) for name, share in done.items() if share < 1.0]
        speed, elapsed = float(self.workers), time.monotonic() - self._start  # core seconds in a second
        if elapsed > TRUST_AFTER:
            running = sum(costs[name] * share for name, share in self._fractions.items())
            speed = max((self._done_here + running) / elapsed, 0.01)
        share = 1.0 - sum(left) / sum(costs.values())
        return share, max(sum(left) / speed, *left) if left else 0.0

    def _show(self) -> None:
        if self._console.is_terminal:
            share, left = self._look()
            words = f"{duration(left)} left" if left else "done"
            self._bars.update(self._bar, completed=share, description=words)
        else:
            print(f"[{duration(time.monotonic() - self._start)}] {self.summary()}", flush=True)

    def _log(self, text: str) -> None:
        with suppress(OSError), (self._store.directory / LOG).open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
