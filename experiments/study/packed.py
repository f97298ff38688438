"""Finished cells packed into tables, read.

DIR/packed.json        version of the layout, and the SHA-256 of each table
DIR/cells.parquet      one row per cell: its name, setting, commit, time, and all of cell.json as text (`record`)
DIR/episodes.parquet, gates.parquet, training.parquet, marks.parquet
                       the rows of the cells' own tables of these names, behind a column `cell`
DIR/weights/           the weights that are kept, CELL.npz

`pack` writes them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.support.errors import UserError
from experiments.support.files import sha256_file

if TYPE_CHECKING:
    import pandas as pd

LAYOUT = 1  # of the tables; raise it with every change that older versions cannot read
MANIFEST, CELLS, WEIGHTS = "packed.json", "cells.parquet", "weights"


class DamagedTable(UserError):
    """A packed table that cannot be what was written."""

    def __init__(self, file: Path, reason: str) -> None:
        super().__init__(
            f"{file} is damaged ({reason}): restore it from a copy (git checkout {file}, for a published one)"
        )


class Packed:
    """The packed cells of a directory, none if nothing was packed there. Tables are read, and checked, when needed.

    Raises:
        UserError: a file is damaged, or of a version that this one does not know.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.checksums = _checksums(directory / MANIFEST)

    @cached_property
    def records(self) -> Mapping[str, dict[str, Any]]:
        """cell.json of each packed cell, by name in alphabetical order."""
        if not self.checksums:
            return {}
        rows = self._read(CELLS)
        try:
            return {name: json.loads(text) for name, text in zip(rows["cell"], rows["record"], strict=True)}
        except (KeyError, ValueError) as error:
            raise DamagedTable(self.directory / CELLS, str(error)) from None

    def table(self, file: str) -> pd.DataFrame | None:
        """The rows of all packed cells' tables of this name, with the column `cell`; None if no cell has one."""
        if file not in self.checksums:
            return None
        rows = self._read(file)
        return rows[rows["cell"].isin(self.records.keys())]

    def tables(self, name: str) -> dict[str, pd.DataFrame]:
        """The tables of one cell, by the names of their files."""
        found = {}
        for file in sorted(set(self.checksums) - {CELLS}):
            rows = self.table(file)
            if rows is not None and file in self.records[name]["files"]:
                rows = rows[rows["cell"] == name]
                if len(rows):
                    found[file] = rows.drop(columns="cell").reset_index(drop=True)
        return found

    def weights(self, name: str) -> Path:
        """Where the weights of an agent lie, if they are kept."""
        return self.directory / WEIGHTS / f"{name}.npz"

    def _read(self, file: str) -> pd.DataFrame:
        import pandas as pd
        import pyarrow

        path = self.directory / file
        try:
            if sha256_file(path) not in self.checksums[file]:
                raise DamagedTable(path, "its checksum does not match")
            return pd.read_parquet(path)
        except (OSError, pyarrow.ArrowException) as error:
            raise DamagedTable(path, str(error).partition("\n")[0]) from None


def read_packed(directory: Path) -> Packed:
    """The packed cells of a directory; read again only when they have changed."""
    manifest = directory / MANIFEST
    return _cached(directory, manifest.stat().st_mtime_ns if manifest.exists() else 0)


@lru_cache(8)
def _cached(directory: Path, changed: int) -> Packed:
    return Packed(directory)


def _checksums(manifest: Path) -> dict[str, list[str]]:
    """The checksums that each table may have: two while it is being replaced, else one."""
    if not manifest.exists():
        return {}
    try:
        value = json.loads(manifest.read_text())
        layout, files = value["layout"], {name: list(sums) for name, sums in value["files"].items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise DamagedTable(manifest, f"{type(error).__name__}: {error}") from None
    if layout != LAYOUT:
        raise UserError(
            f"{manifest} is of layout {layout}, and this version reads layout {LAYOUT}: use the version that wrote it"
        )
    return files
