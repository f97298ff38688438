"""What a person sees of a running sweep: in a terminal bars that move, elsewhere a line now and then.

Everything that happens is also written to DIR/sweep.log, one line each, which can be followed with `tail -f` wherever
the sweep runs.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

from rich.console import Console
from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from experiments.study.attempt import Sign
from experiments.study.cell import CellTask
from experiments.study.estimate import Rates, duration
from experiments.study.grid import Cell
from experiments.study.run import RETRIES, Observer
from experiments.study.store import Store, read_stored

LINE_EVERY = 15.0  # [s] between lines where nobody watches
LOG_EVERY = 300.0  # [s] between lines in the log
TRUST_AFTER = 60.0  # [s] from when on the speed of this run counts, and not its number of workers
SHARE = (
    0.05  # of its time that a sweep spends on this at most: with 10,000 cells one look takes half a second
)
LOG = "sweep.log"
ALL = "all"


class Progress(Observer[CellTask]):
    """Follows the cells of a sweep.

    Args:
        finished: names of the cells that were there before.
        workers: how many cells are computed at a time.
        command: computes one cell, whose name is to be appended.
    """

    def __init__(
        self,
        store: Store,
        cells: Sequence[Cell],
        finished: set[str],
        rates: Rates,
        workers: int,
        command: str,
    ) -> None:
        self._cells = {cell.name: cell for cell in cells}
        self._state = {name: "finished" if name in finished else "waiting" for name in self._cells}
        self._store, self._rates, self._workers, self._command = store, rates, workers, command
        self._fractions: dict[str, float] = {}  # of running cells
        self._done_here = 0.0  # estimated core time of what this run finished [s]
        self._start = self._logged = self._next = time.monotonic()
        self._printed = self._start - LINE_EVERY
        self._console = Console(highlight=False)
        left = TextColumn("{task.fields[left]}")
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            left,
        )
        self._bars = Bars(*columns, console=self._console, disable=not self._console.is_terminal)
        tasks = dict.fromkeys(cell.task for cell in cells)
        self._lines = {task: self._bars.add_task(task, total=1.0, left="") for task in (*tasks, ALL)}
        self._bars.start()
        self._log(f"{len(cells)} cells, {len(finished)} of them finished before, {workers} workers")

    def started(self, task: CellTask) -> None:
        """A try begins, or waits in the executor's queue."""
        self._set(task, "running", "started")

    def finished(self, task: CellTask, remark: str) -> None:
        """The result is there, and the estimate learns from it."""
        with suppress(Exception):  # one that is damaged by now is found by whoever reads it
            self._rates.learn(read_stored(self._store.directory, task.name))
        self._done_here += self._rates.seconds(task.cell)
        self._set(task, "finished", "finished")
        if remark:
            self._say(f"{task.name}: {remark}")

    def again(self, task: CellTask, reason: str, number: int) -> None:
        """It went wrong and is retried."""
        self._set(task, "waiting")
        self._say(f"{task.name}: {reason}; retry {number} of {RETRIES}")

    def failed(self, task: CellTask, reason: str) -> None:
        """It went wrong for the last time."""
        self._set(task, "failed")
        with suppress(OSError):  # on a full disk the report says that the cell is missing
            self._store.write_failure(task.name, reason, f"{self._command} {task.name}")
        self._say(f"{task.name}: {reason}; given up after {RETRIES} retries")

    def elsewhere(self, task: CellTask) -> None:
        """Another sweep computes it."""
        self._set(task, "in another sweep")

    def tick(self, running: Mapping[str, Sign | None]) -> None:
        """Show it."""
        self._fractions = {name: sign.fraction for name, sign in running.items() if sign is not None}
        now = time.monotonic()
        if now < self._next:
            return
        self._show()
        if now - self._logged > LOG_EVERY:
            self._logged = now
            self._log(self.summary())
        self._next = now + (time.monotonic() - now) / SHARE

    def close(self) -> None:
        """Leave the screen in order, and the last state in the log."""
        self._printed = -LINE_EVERY
        self._show()
        self._bars.stop()
        self._log(self.summary())

    def left(self, names: Iterable[str]) -> float:
        """Expected time [s] until some cells are done, if only they are worked on."""
        work = [
            self._rates.seconds(self._cells[name]) * (1.0 - self._fractions.get(name, 0.0))
            for name in names
            if self._state[name] not in ("finished", "failed")
        ]
        return max(sum(work) / self._speed(), *work) if work else 0.0

    def _speed(self) -> float:
        """Estimated core time that passes in a second: as measured in this run, else one per worker."""
        elapsed = time.monotonic() - self._start
        if elapsed < TRUST_AFTER:
            return self._workers
        running = (
            self._rates.seconds(self._cells[name]) * fraction for name, fraction in self._fractions.items()
        )
        return max((self._done_here + sum(running)) / elapsed, 0.01)

    def share(self, names: Sequence[str]) -> float:
        """Share of the work of some cells that is done, by the estimate."""
        costs = {name: self._rates.seconds(self._cells[name]) for name in names}
        done = {
            name: 1.0 if self._state[name] == "finished" else self._fractions.get(name, 0.0) for name in names
        }
        return sum(costs[name] * done[name] for name in names) / sum(costs.values()) if names else 1.0

    def summary(self) -> str:
        """All of it in one line."""
        counts = Counter(self._state.values())
        parts = [
            f"{counts.pop('finished', 0)}/{len(self._cells)} cells",
            f"{self.share(list(self._cells)):.0%}",
        ]
        if left := self.left(self._cells):
            parts.append(f"about {duration(left)} left")
        parts += [f"{number} {state}" for state, number in counts.items() if state != "running"]
        running = [self._cells[name].slug for name, state in self._state.items() if state == "running"]
        more = f" and {len(running) - 4} more" if len(running) > 4 else ""
        if running:
            parts.append(f"running {', '.join(running[:4])}{more}")
        return ", ".join(parts)

    def _show(self) -> None:
        if not self._console.is_terminal:
            if time.monotonic() - self._printed >= LINE_EVERY:
                self._printed = time.monotonic()
                print(f"[{duration(self._printed - self._start)}] {self.summary()}", flush=True)
            return
        for task, line in self._lines.items():
            names = [name for name, cell in self._cells.items() if task in (ALL, cell.task)]
            left = self.left(names)
            remaining = f"about {duration(left)} left" if left else "done"
            self._bars.update(line, completed=self.share(names), left=remaining)

    def _set(self, task: CellTask, state: str, text: str = "") -> None:
        self._state[task.name] = state
        self._fractions.pop(task.name, None)
        if text:
            self._log(f"{task.name} {text}")

    def _say(self, text: str) -> None:
        if self._console.is_terminal:
            self._console.print(text, markup=False, soft_wrap=True)
        else:
            print(text, flush=True)
        self._log(text)

    def _log(self, text: str) -> None:
        with suppress(OSError), (self._store.directory / LOG).open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
