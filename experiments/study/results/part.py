"""Files of episodes that are no cells: batches, and the record of takeover.py.

As a cell such a file is written whole or not at all, and never believed once a byte of it has changed (`parquet`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa

from experiments.study.results.parquet import Damaged, asked_of, packed, unpacked
from experiments.study.results.schema import as_table, schema_of
from experiments.support.files import made, write_file


class DamagedEpisodes(Damaged):
    """Episodes that can be driven again."""

    remedy = "run the same command again, which drives its episodes again"


def read_part(
    path: Path, name: str, columns: Mapping[str, str], episodes: Mapping[str, Sequence[Any]]
) -> pd.DataFrame:
    """The episodes in a file. Raises DamagedEpisodes.

    Args:
        name: of what is computed, which the file has to have too.
        columns: by name the type, as in `schema.schema_of`; of those of "float32" and "float64" values may be missing.
        episodes: in these columns the values of each row, in order.
    """

    def checked(path: Path) -> pd.DataFrame:
        table, found = unpacked(path, _schema(columns))
        if found != name:
            raise ValueError(f"its content is that of {found}")
        return _expected(table, episodes).to_pandas()

    return asked_of(path, checked, DamagedEpisodes)


def write_part(
    path: Path,
    name: str,
    columns: Mapping[str, str],
    rows: pd.DataFrame,
    episodes: Mapping[str, Sequence[Any]],
) -> None:
    """Store episodes. Raises ValueError where they are not those that a reader takes; OSError."""
    table = _expected(as_table(rows, _schema(columns)), episodes)
    made(path.parent)
    write_file(path, packed(table, name))


def _schema(columns: Mapping[str, str]) -> pa.Schema:
    return schema_of(columns, [name for name, kind in columns.items() if "float" in kind])


def _expected(table: pa.Table, episodes: Mapping[str, Sequence[Any]]) -> pa.Table:
    """The rows, which are those of the episodes, or it raises ValueError."""
    for column, values in episodes.items():
        if table[column].to_pylist() != list(values):
            raise ValueError(f"its episodes are not those that are asked for: look at {column}")
    return table
