"""Finished cells packed into a few tables: read, and added to.

DIR/packed.json        version of the layout, and the SHA-256 of each table
DIR/cells.parquet      one row per cell: its name, setting, commit, time, and all of cell.json as text (`record`)
DIR/episodes.parquet, gates.parquet, training.parquet, marks.parquet
                       the rows of the cells' own tables of these names, behind a column `cell`
DIR/weights/           the weights that are kept, CELL.npz
"""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Mapping, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.grid import setting
from experiments.support.errors import UserError
from experiments.support.files import sha256_bytes, sha256_file, write_file, write_json

if TYPE_CHECKING:
    import pandas as pd

LAYOUT = 1  # of the tables; raise it with every change that older versions cannot read
MANIFEST, CELLS, WEIGHTS = "packed.json", "cells.parquet", "weights"
COMPACT: dict[str, Any] = {"compression": "zstd", "write_statistics": False, "store_schema": False}

Records = Mapping[str, Mapping[str, Any]]  # cell.json by cell
Tables = Mapping[str, "pd.DataFrame"]  # by the name of their file


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
        self._rows: dict[str, dict[str, pd.DataFrame]] = {}

    @cached_property
    def records(self) -> dict[str, dict[str, Any]]:
        """cell.json of each packed cell, by name in alphabetical order."""
        if not self.checksums:
            return {}
        return _records(self._read(CELLS))

    def rows(self, file: str) -> dict[str, pd.DataFrame]:
        """The tables of this name by cell. A column that a cell's own table lacks is missing in all its rows."""
        if file not in self._rows:
            by_cell = _by_cell(self._read(file)) if file in self.checksums else {}
            # A kill while packing may leave rows of cells that are not in the index yet.
            self._rows[file] = {name: rows for name, rows in by_cell.items() if name in self.records}
        return self._rows[file]

    def tables(self, name: str, wanted: Sequence[str]) -> dict[str, pd.DataFrame]:
        """The wanted tables of one cell that there are, by the names of their files."""
        return {file: self.rows(file)[name] for file in wanted if name in self.rows(file)}

    def weights(self, name: str) -> Path:
        """Where the weights of an agent lie, if they are kept."""
        return self.directory / WEIGHTS / f"{name}.npz"

    def _read(self, file: str) -> pd.DataFrame:
        import pandas as pd

        path = self.directory / file
        try:
            found = sha256_file(path)
        except OSError as error:
            raise DamagedTable(path, error.strerror or "unreadable") from None
        if found not in self.checksums[file]:
            raise DamagedTable(path, "its checksum does not match")
        return pd.read_parquet(path)


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
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise DamagedTable(manifest, f"{type(error).__name__}: {error}") from None
    if layout != LAYOUT:
        raise UserError(
            f"{manifest} is of layout {layout}, and this version reads layout {LAYOUT}: use the version that wrote it"
        )
    return files


def add(directory: Path, records: Records, tables: Mapping[str, Tables], weights: Mapping[str, Path]) -> None:
    """Pack further cells: nothing is deleted, and what is to be written is read back and compared first.

    Args:
        records, tables: cell.json and the tables of the cells, by their names.
        weights: files of the weights that are to be kept, by cell.

    Raises:
        UserError: a packed table is damaged, or does not read back equal.
    """
    import pandas as pd

    packed = Packed(directory)
    everything = {**packed.records, **records}
    contents = {CELLS: as_parquet(_index(everything))}
    if _records(pd.read_parquet(io.BytesIO(contents[CELLS]))) != everything:
        raise UserError("the packed cell.json of some cells are not what they were: nothing was packed")
    for file in sorted({*packed.checksums, *(file for own in tables.values() for file in own)} - {CELLS}):
        parts = {**packed.rows(file), **{name: own[file] for name, own in tables.items() if file in own}}
        joined = pd.concat([parts[name].assign(cell=name) for name in sorted(parts)], ignore_index=True)
        contents[file] = as_parquet(joined[["cell", *joined.columns.drop("cell")]])
        _check(file, _by_cell(pd.read_parquet(io.BytesIO(contents[file]))), parts)
    for name, path in weights.items():
        packed.weights(name).parent.mkdir(exist_ok=True)
        shutil.copyfile(path, packed.weights(name))
    _write(directory, contents, packed.checksums)


def as_parquet(table: pd.DataFrame) -> bytes:
    """The bytes of a stored table: the same for the same content."""
    return table.to_parquet(index=False, **COMPACT)


def _index(records: Records) -> pd.DataFrame:
    """One row per cell; `record` is all of cell.json, the other columns are for people who read the table."""
    import pandas as pd

    rows = [
        {
            "cell": name,
            "setting": setting(record["key"]),
            "git": record["provenance"].get("git"),
            "finished": record["timing"].get("finished"),
            "record": json.dumps(record, allow_nan=False),
        }
        for name, record in sorted(records.items())
    ]
    return pd.DataFrame(rows).astype("str")


def _records(index: pd.DataFrame) -> dict[str, dict[str, Any]]:
    return {name: json.loads(text) for name, text in zip(index["cell"], index["record"], strict=True)}


def _by_cell(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {
        name: rows.drop(columns="cell").reset_index(drop=True)
        for name, rows in table.groupby("cell", sort=False)
    }


def _check(file: str, found: Tables, expected: Tables) -> None:
    """Raise UserError unless the tables of all cells are as expected; columns may be missing there."""
    if found.keys() != expected.keys():
        raise UserError(f"the packed {file} has rows of other cells: nothing was packed")
    for name, rows in expected.items():
        added = found[name].columns.difference(rows.columns)
        same = found[name][list(rows.columns)].equals(rows.reset_index(drop=True))
        if not same or found[name][added].notna().any(axis=None):
            raise UserError(f"{file} of {name} does not read back as it was: nothing was packed")


def _write(directory: Path, contents: Mapping[str, bytes], before: Mapping[str, list[str]]) -> None:
    """Replace the tables, the index last, so that what is there can be read after a kill at any moment."""
    new = {file: [sha256_bytes(data)] for file, data in contents.items()}
    either = {file: [*digest, *before.get(file, [])] for file, digest in new.items()}
    write_json(directory / MANIFEST, {"layout": LAYOUT, "files": either})
    for file in sorted(contents, key=lambda file: file == CELLS):
        write_file(directory / file, contents[file])
    write_json(directory / MANIFEST, {"layout": LAYOUT, "files": new})
