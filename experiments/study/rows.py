"""A table that is computed row by row and goes on where it was stopped."""

from __future__ import annotations

import io
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.estimate import duration
from experiments.support.errors import UserError
from experiments.support.files import write_file

if TYPE_CHECKING:
    import pandas as pd

EVERY = 15.0  # [s] between lines where nobody watches


def fill(
    file: Path,
    wanted: Sequence[Mapping[str, Any]],
    compute: Callable[[Mapping[str, Any]], Mapping[str, Any] | None],
) -> pd.DataFrame:
    """The wanted rows, each with the columns that `compute` adds to it (None: none).

    The file keeps every row that was ever computed, so that the same call goes on where it was stopped.

    Raises:
        UserError: the file is something else.
    """
    import pandas as pd

    table = pd.DataFrame()
    if file.exists():
        try:
            table = pd.read_parquet(file)
        except (OSError, ValueError) as error:
            raise UserError(
                f"{file} is no table of this command ({error}): name another file with --out"
            ) from None
    keys = list(wanted[0]) if wanted else []
    if len(table) and not set(keys) <= set(table):
        raise UserError(f"{file} is a table of something else: name another file with --out")
    there = set(map(tuple, table[keys].to_numpy().tolist())) if len(table) else set()
    missing = [row for row in wanted if tuple(row.values()) not in there]
    countdown = Countdown(len(missing))
    for number, row in enumerate(missing):
        countdown.show(number, f"{len(there) + number} of {len(wanted)} rows")
        added = compute(row)
        if added is not None:
            table = pd.concat([table, pd.DataFrame([{**row, **added}])], ignore_index=True)
            buffer = io.BytesIO()
            table.to_parquet(buffer, index=False, compression="zstd")
            write_file(file, buffer.getvalue())
    countdown.end()
    return table.merge(pd.DataFrame(wanted), on=keys) if len(table) else table


class Countdown:
    """Says how much is done and how long the rest will take: on one line of a terminal, elsewhere every 15 s."""

    def __init__(self, total: float) -> None:
        self._total, self._start = total, time.monotonic()
        self._shown = self._start
        self._watched = sys.stderr.isatty()

    def show(self, done: float, text: str) -> None:
        """Say it, if it is time to."""
        now = time.monotonic()
        if now - self._shown < (0.2 if self._watched else EVERY):
            return
        self._shown = now
        left = (now - self._start) * (self._total - done) / done if done else float("nan")
        line = text + (f", about {duration(left)} left" if done else "")
        print(
            f"\r{line:<70}" if self._watched else line,
            end="" if self._watched else "\n",
            file=sys.stderr,
            flush=True,
        )

    def end(self) -> None:
        """Clear the line."""
        if self._watched:
            print("\r" + " " * 70 + "\r", end="", file=sys.stderr, flush=True)
