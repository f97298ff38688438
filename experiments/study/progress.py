"""What a person sees of a running sweep: in a terminal a table that moves, elsewhere a line now and then.

Everything that happens is also written to DIR/sweep.log, one line each, which can be followed with `tail -f` wherever
the sweep runs.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import timedelta
from typing import Any, Protocol

from experiments.study.arms import ARMS
from experiments.study.attempt import Sign
from experiments.study.cell import CellTask
from experiments.study.estimate import Rates, duration
from experiments.study.grid import Cell
from experiments.study.run import RETRIES
from experiments.study.store import CELL, Store

LINE_EVERY = 15.0  # [s] between lines where nobody watches
LOG_EVERY = 300.0  # [s] between summaries in the log
TRUST_AFTER = (
    60.0  # [s] from when on the speed of this run is believed rather than that of its number of workers
)
SHARE = (
    0.05  # of its time that a sweep spends on this at most: with 10,000 cells one look takes half a second
)
LOG = "sweep.log"
STATES = ("finished", "running", "waiting", "elsewhere", "failed")


class Screen(Protocol):
    """Where the state of a sweep is shown."""

    def show(self, progress: Progress) -> None:
        """Show it."""

    def line(self, text: str) -> None:
        """Print a line that stays."""

    def close(self, progress: Progress) -> None:
        """Show the last state and leave the screen in order."""


class Progress:
    """Follows the cells of a sweep (a `run.Observer`).

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
        screen: Screen,
        command: str,
    ) -> None:
        self.cells = {cell.name: cell for cell in cells}
        self.state = {name: "finished" if name in finished else "waiting" for name in self.cells}
        self._store, self._rates, self._workers, self._screen = store, rates, workers, screen
        self._command = command
        self._fractions: dict[str, float] = {}
        self._begun: dict[str, float] = {}
        self._done_here = 0.0  # estimated core time of what this run finished [s]
        self._start = time.monotonic()
        self._logged = self._next = self._start
        self._log(f"{len(cells)} cells, {len(finished)} of them finished before, {workers} workers")

    # What the runner tells.

    def started(self, task: CellTask) -> None:
        """A try begins, or waits in the executor's queue."""
        self._set(task, "running", "started")
        self._begun[task.name] = time.monotonic()

    def finished(self, task: CellTask, remark: str) -> None:
        """The result is there."""
        self._rates.learn(self._store.cells / task.name / CELL)
        self._done_here += self._rates.seconds(task.cell)
        self._set(task, "finished", f"finished after {duration(time.monotonic() - self._begun[task.name])}")
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
        self._set(task, "elsewhere")

    def tick(self, running: Mapping[str, Sign | None]) -> None:
        """Show it, and summarise it in the log now and then."""
        self._fractions = {name: sign.fraction for name, sign in running.items() if sign is not None}
        now = time.monotonic()
        if now < self._next:
            return
        self._screen.show(self)
        self._next = now + (time.monotonic() - now) / SHARE
        if time.monotonic() - self._logged > LOG_EVERY:
            self._logged = time.monotonic()
            for text in (self.summary(), *map(_row_text, self.rows())):
                self._log(text)

    def close(self) -> None:
        """Leave the screen in order, and the last state in the log."""
        self._screen.close(self)
        for text in (self.summary(), *map(_row_text, self.rows())):
            self._log(text)

    # What screens ask.

    @property
    def elapsed(self) -> float:
        """Time since the beginning [s]."""
        return time.monotonic() - self._start

    def left(self, cells: Sequence[Cell] | None = None) -> float:
        """Expected time [s] until some cells, or all, are done, if only they are worked on."""
        names = self.cells if cells is None else {cell.name: cell for cell in cells}
        work = [
            self._rates.seconds(cell) * (1.0 - self._fractions.get(name, 0.0))
            for name, cell in names.items()
            if self.state[name] in ("running", "waiting", "elsewhere")
        ]
        return max(sum(work) / self._speed(), *work) if work else 0.0

    def _speed(self) -> float:
        """Estimated core time that passes in a second: as measured in this run, else one a worker."""
        if self.elapsed < TRUST_AFTER:
            return self._workers
        done = self._done_here + sum(
            self._rates.seconds(self.cells[name]) * fraction for name, fraction in self._fractions.items()
        )
        return max(done / self.elapsed, 0.01)

    def counts(self) -> Counter[str]:
        """Number of cells in each state."""
        return Counter(self.state.values())

    def running(self) -> list[str]:
        """What runs, with the share that is done."""
        return [
            f"{self.cells[name].slug} {self._fractions[name]:.0%}" if name in self._fractions else
            f"{self.cells[name].slug} (queued)"
            for name, state in self.state.items() if state == "running"
        ]  # fmt: skip

    def fraction(self) -> float:
        """Share of the whole work that is done, by the estimate."""
        costs = {name: self._rates.seconds(cell) for name, cell in self.cells.items()}
        done = sum(
            cost * (1.0 if self.state[name] == "finished" else self._fractions.get(name, 0.0))
            for name, cost in costs.items()
        )
        return done / sum(costs.values()) if costs else 1.0

    def summary(self) -> str:
        """All of it in one line."""
        counts = self.counts()
        parts = [f"{counts['finished']}/{len(self.cells)} cells", f"{self.fraction():.0%}"]
        if counts["running"] or counts["waiting"] or counts["elsewhere"]:
            parts.append(f"about {duration(self.left())} left")
        for state in ("waiting", "elsewhere", "failed"):
            if counts[state]:
                parts.append(f"{counts[state]} {state if state != 'elsewhere' else 'in another sweep'}")
        if running := self.running():
            more = f" and {len(running) - 4} more" if len(running) > 4 else ""
            parts.append(f"running {', '.join(running[:4])}{more}")
        return ", ".join(parts)

    def rows(self) -> list[tuple[str, ...]]:
        """Task, finished and wanted cells of each arm and of the policies that do not learn, time left."""
        rows = []
        for task in dict.fromkeys(cell.task for cell in self.cells.values()):
            mine = [cell for cell in self.cells.values() if cell.task == task]
            shares = []
            for arm in (*ARMS, None):
                names = [cell.name for cell in mine if cell.arm == arm]
                done = sum(self.state[name] == "finished" for name in names)
                shares.append(f"{done}/{len(names)}" if names else "")
            left = self.left(mine)
            rows.append((task, *shares, duration(left) if left else DONE))
        return rows

    # What stays.

    def _set(self, task: CellTask, state: str, text: str = "") -> None:
        self.state[task.name] = state
        self._fractions.pop(task.name, None)
        if text:
            self._log(f"{task.name} {text}")

    def _say(self, text: str) -> None:
        self._screen.line(text)
        self._log(text)

    def _log(self, text: str) -> None:
        with suppress(OSError), (self._store.directory / LOG).open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")


DONE = "done"
HEADER = ("task", *ARMS, "policies", "left")


def _row_text(row: Sequence[str]) -> str:
    task, *shares, left = row
    parts = [f"{name} {share}" for name, share in zip(HEADER[1:], shares, strict=False) if share]
    return f"  {task}: {', '.join(parts)}, {left if left == DONE else f'about {left} left'}"


def clock(seconds: float) -> str:
    """Hours, minutes and seconds: 0:02:05."""
    return str(timedelta(seconds=int(seconds)))


class Plain:
    """Lines for logs and pipes."""

    def __init__(self) -> None:
        self._last = -LINE_EVERY

    def show(self, progress: Progress) -> None:
        """Print a line when the last one is old enough."""
        if time.monotonic() - self._last >= LINE_EVERY:
            self._last = time.monotonic()
            print(f"[{clock(progress.elapsed)}] {progress.summary()}", flush=True)

    def line(self, text: str) -> None:
        """Print a line."""
        print(text, flush=True)

    def close(self, progress: Progress) -> None:
        """Print the last state."""
        print(f"[{clock(progress.elapsed)}] {progress.summary()}", flush=True)
        for row in progress.rows():
            print(_row_text(row), flush=True)


class Table:
    """A bar, one line a state, and a table of tasks and arms, redrawn in place."""

    def __init__(self) -> None:
        from rich.live import Live

        self._live = Live(auto_refresh=False)
        self._live.start()

    def show(self, progress: Progress) -> None:
        """Draw it anew."""
        self._live.update(_drawing(progress), refresh=True)

    def line(self, text: str) -> None:
        """Print a line above."""
        self._live.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def close(self, progress: Progress) -> None:
        """Draw it for the last time."""
        self.show(progress)
        self._live.stop()


def _drawing(progress: Progress) -> Any:
    from rich.columns import Columns
    from rich.console import Group
    from rich.progress_bar import ProgressBar
    from rich.table import Table as Grid

    fraction, counts, left = progress.fraction(), progress.counts(), progress.left()
    bar = Columns(
        [
            ProgressBar(total=1.0, completed=fraction, width=40),
            f"{fraction:.0%}, {clock(progress.elapsed)} so far"
            + (f", about {duration(left)} left" if left else ""),
        ]
    )
    states = Grid.grid(padding=(0, 2))
    for state in STATES:
        if counts[state]:
            names = progress.running() if state == "running" else []
            states.add_row(
                state, str(counts[state]), ", ".join(names), style="red" if state == "failed" else ""
            )
    table = Grid(*HEADER, box=None, header_style="dim", padding=(0, 2))
    for row in progress.rows():
        table.add_row(*row)
    return Group(bar, states, table)


def screen() -> Screen:
    """A table if a person watches, lines otherwise."""
    return Table() if sys.stdout.isatty() else Plain()
