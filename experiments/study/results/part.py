"""A file of episodes that is no cell: a batch of rare.py, or a part of validate.py.

As a cell it is written whole or not at all, and never believed once a byte of it has changed (`parquet`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class PartFile:
    """Where the episodes of a task are stored, and which.

    name: of what is computed, which the file has to have too. columns: by name the type, as in `schema.schema_of`; of
    those of "float32" and "float64" values may be missing. episodes: in these columns the values of each row, in order.
    """

    path: Path
    name: str
    columns: Mapping[str, str]
    episodes: Mapping[str, Sequence[Any]]

    @property
    def _schema(self) -> pa.Schema:
        return schema_of(self.columns, [name for name, kind in self.columns.items() if "float" in kind])

    def done(self) -> bool:
        """Whether it is stored; one that is damaged is named, and its episodes are to be driven again."""
        if not self.path.exists():
            return False
        try:
            self.read()
        except DamagedEpisodes as error:
            print(f"{self.path} is damaged ({error.reason}): its episodes are driven again", flush=True)
            return False
        return True

    def read(self) -> pd.DataFrame:
        """The episodes. Raises DamagedEpisodes."""

        def checked(path: Path) -> pd.DataFrame:
            table, name = unpacked(path, self._schema)
            if name != self.name:
                raise ValueError(f"its content is that of {name}")
            return self._expected(table).to_pandas()

        return asked_of(self.path, checked, DamagedEpisodes)

    def write(self, rows: pd.DataFrame) -> None:
        """Store the episodes. Raises ValueError where they are not those that a reader takes; OSError."""
        table = self._expected(as_table(rows, self._schema))
        made(self.path.parent)
        write_file(self.path, packed(table, self.name))

    def _expected(self, table: pa.Table) -> pa.Table:
        """The rows, which are those of the episodes, or it raises ValueError."""
        for column, values in self.episodes.items():
            if table[column].to_pylist() != list(values):
                raise ValueError(f"its episodes are not those that are asked for: look at {column}")
        return table
