"""A table that is computed row by row and goes on where it was stopped."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import track

from experiments.support.errors import UserError
from experiments.support.files import write_file

if TYPE_CHECKING:
    import pandas as pd


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
    for row in track(missing, f"{len(there)} of {len(wanted)} rows are there", console=Console(stderr=True)):
        added = compute(row)
        if added is not None:
            table = pd.concat([table, pd.DataFrame([{**row, **added}])], ignore_index=True)
            write_file(file, table.to_parquet(index=False, compression="zstd"))
    return table.merge(pd.DataFrame(wanted), on=keys) if len(table) else table
