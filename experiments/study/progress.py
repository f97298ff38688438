"""What a person sees of a running sweep: a bar in a terminal, a line now and then in a log."""

from __future__ import annotations

import sys
import time
from typing import Protocol

from experiments.study.estimate import duration

INTERVAL = 15.0  # [s] between lines in a log


class Display(Protocol):
    """Shows how far a sweep is."""

    def update(self, fraction: float, finished: int, total: int, note: str) -> None:
        """Show the share of the work that is done (0 to 1), the cells that are, and what is going on."""

    def line(self, text: str) -> None:
        """Print a line that stays."""

    def close(self) -> None:
        """Leave the screen in order."""


class Plain:
    """Lines for logs and pipes."""

    def __init__(self) -> None:
        self._start = time.monotonic()
        self._last = self._start - INTERVAL

    def update(self, fraction: float, finished: int, total: int, note: str) -> None:
        """Print a line when the last one is old enough."""
        now = time.monotonic()
        if now - self._last < INTERVAL:
            return
        self._last = now
        elapsed = now - self._start
        left = f", about {duration(elapsed * (1 - fraction) / fraction)} left" if fraction > 0.02 else ""
        print(f"[{duration(elapsed):>6}] {finished}/{total} cells, {fraction:.0%}{left}; {note}", flush=True)

    def line(self, text: str) -> None:
        """Print a line."""
        print(text, flush=True)

    def close(self) -> None:
        """Nothing to do."""


class Bar:
    """A progress bar with the time left."""

    def __init__(self) -> None:
        from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

        self._progress = Progress(
            TextColumn("{task.fields[cells]} cells"),
            BarColumn(bar_width=None),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}"),
            TextColumn("{task.fields[note]}", style="dim"),
            expand=True,
        )
        self._start = time.monotonic()
        self._task = self._progress.add_task("sweep", total=1.0, cells="0", left="", note="")
        self._progress.start()

    def update(self, fraction: float, finished: int, total: int, note: str) -> None:
        """Move the bar."""
        elapsed = time.monotonic() - self._start
        left = f"{duration(elapsed * (1 - fraction) / fraction)} left" if fraction > 0.02 else ""
        self._progress.update(
            self._task, completed=fraction, cells=f"{finished}/{total}", left=left, note=note
        )

    def line(self, text: str) -> None:
        """Print a line above the bar."""
        self._progress.console.print(text, highlight=False, markup=False, soft_wrap=True)

    def close(self) -> None:
        """Stop drawing."""
        self._progress.stop()


def display() -> Display:
    """A bar if a person watches, lines otherwise."""
    return Bar() if sys.stdout.isatty() else Plain()
