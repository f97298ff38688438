"""Finished cells packed into a few tables: read, and added to.

DIR/packed.json        version of the layout, and the SHA-256 of each table
DIR/cells.parquet      one row per cell: its name, and all of cell.json as text (`record`)
DIR/episodes.parquet, gates.parquet, training.parquet (and tables of earlier versions)
                       the rows of the cells' own tables of these names, behind a column `cell`
DIR/weights/           the weights that are kept, CELL.npz
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import pandas as pd

from agents.files import open_regular
from agents.schema import Wrong, check, parsed, shortened
from experiments.study.results.schema import TEXT, check_columns, check_episodes, check_record
from experiments.support.errors import UserError
from experiments.support.files import (
    is_name,
    made,
    read_json,
    sha256_bytes,
    sha256_file,
    write_file,
    write_json,
)

LAYOUT = 1  # of the tables; raise it with every change that older versions cannot read
MANIFEST, CELLS, WEIGHTS = "packed.json", "cells.parquet", "weights"
COMPACT: dict[str, Any] = {"compression": "zstd", "write_statistics": False, "store_schema": False}


class DamagedTable(UserError):
    """A packed table that cannot be what was written."""

    def __init__(self, file: Path, reason: str) -> None:
        super().__init__(
            f"{file} is damaged ({reason}): restore it from a copy (git checkout {file}, for a published one)"
        )


def packed_records(directory: Path) -> dict[str, dict[str, Any]]:
    """cell.json of each packed cell, by name in alphabetical order. Raises UserError as `checksums` does."""
    sums = checksums(directory)
    return _records(directory / CELLS, sums[CELLS]) if sums else {}


def packed_tables(directory: Path, file: str) -> dict[str, pd.DataFrame]:
    """The packed tables of this name by cell. A column that a cell's own table lacks is missing in all its rows.

    A kill while packing may leave rows of cells that have no record yet. Raises UserError as `checksums` does.
    """
    sums = checksums(directory)
    return _tables(directory / file, sums[file]) if file in sums else {}


def packed_weights(directory: Path, name: str) -> Path:
    """Where the weights of a packed agent lie, if they are kept."""
    return directory / WEIGHTS / f"{name}.npz"


def checksums(directory: Path) -> dict[str, tuple[str, ...]]:
    """The valid checksums of each packed table: the old and the new one while the table is being replaced, else one.

    Raises:
        UserError: the manifest is damaged, or of a version that this one does not know.
    """
    manifest = directory / MANIFEST
    try:
        value = read_json(manifest)
        check(value, {"layout": int, "files": dict})
        layout, files = value["layout"], {name: tuple(sums) for name, sums in value["files"].items()}
        if layout == LAYOUT and not (CELLS in files and all(map(is_name, files))):
            raise Wrong(f"it names files elsewhere, or no {CELLS}: {list(files)}")
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError) as error:
        raise DamagedTable(manifest, f"{type(error).__name__}: {error}") from None
    if layout != LAYOUT:
        raise UserError(
            f"{manifest} is of layout {layout}, and this version reads layout {LAYOUT}: use the version that wrote it"
        )
    return files


@lru_cache(8)
def _records(path: Path, sums: tuple[str, ...]) -> dict[str, dict[str, Any]]:
    index, found = _read(path, sums), {}
    for name, text in zip(index["cell"], index["record"], strict=True):
        try:
            if not is_name(name):
                raise Wrong("the name of a cell leads elsewhere")
            if name in found:
                raise Wrong("the cell is there twice")
            found[name] = parsed(text)
            check_record(name, found[name])
        except (TypeError, ValueError) as error:
            raise DamagedTable(path, f"{shortened(name)}: {error}") from None
    return found


@lru_cache(8)
def _tables(path: Path, sums: tuple[str, ...]) -> dict[str, pd.DataFrame]:
    return _by_cell(_read(path, sums))


def _by_cell(table: pd.DataFrame) -> dict[str, pd.DataFrame]:
    return {
        str(name): rows.drop(columns="cell").reset_index(drop=True)
        for name, rows in table.groupby("cell", sort=False)
    }


def _read(path: Path, sums: tuple[str, ...]) -> pd.DataFrame:
    try:
        found = sha256_file(path)
    except OSError as error:
        raise DamagedTable(path, error.strerror or "unreadable") from None
    if found not in sums:
        raise DamagedTable(path, "its checksum does not match")
    try:
        table = read_table(path)
        check_columns(
            table, {"cell": TEXT, "record": TEXT}, ("cell", "record") if path.name == CELLS else ("cell",)
        )
        check_episodes(path.name, table)
    except Wrong as error:
        raise DamagedTable(path, str(error)) from None
    return table


def read_table(path: Path) -> pd.DataFrame:
    """A parquet file. Raises Wrong, whatever pyarrow stumbles over; FileNotFoundError."""
    try:
        with open_regular(path) as file:
            return pd.read_parquet(file)
    except FileNotFoundError:
        raise
    except Exception as error:
        raise Wrong(f"it is no table: {str(error).partition(chr(10))[0]}") from None


def add(
    directory: Path,
    records: Mapping[str, Mapping[str, Any]],
    tables: Mapping[str, Mapping[str, pd.DataFrame]],
    weights: Mapping[str, Path],
) -> None:
    """Pack further cells. What is to be written is read back and compared before; nothing is deleted.

    After a kill at any moment, what was packed before can be read.

    All by cell: records (cell.json), tables by their names, and files of the weights that are to be kept.

    Raises:
        UserError: a packed table is damaged, or a table does not read back equal.
    """
    before, everything = checksums(directory), {**packed_records(directory), **records}
    parts = {
        file: packed_tables(directory, file)
        | {name: own[file] for name, own in tables.items() if file in own}
        for file in sorted({*before, *(file for own in tables.values() for file in own)} - {CELLS})
    }
    parts[CELLS] = {
        name: pd.DataFrame({"record": [json.dumps(record, allow_nan=False)]})
        for name, record in everything.items()
    }
    contents = {file: _joined(file, of_cells) for file, of_cells in parts.items()}
    for name, path in weights.items():
        made(directory / WEIGHTS)
        write_file(packed_weights(directory, name), path.read_bytes())
    new = {file: [sha256_bytes(data)] for file, data in contents.items()}
    for file in contents.keys() - before.keys():  # nobody reads them before the manifest names them
        write_file(directory / file, contents[file])
    if before:
        either = {file: [*digest, *before.get(file, [])] for file, digest in new.items()}
        write_json(directory / MANIFEST, {"layout": LAYOUT, "files": either})
    for file, data in contents.items():  # the records last: a cell of which one is there has all its rows
        if file in before:
            write_file(directory / file, data)
    write_json(directory / MANIFEST, {"layout": LAYOUT, "files": new})


def _joined(file: str, parts: Mapping[str, pd.DataFrame]) -> bytes:
    """The bytes of a packed table, which has been read back."""
    joined = pd.concat([parts[name].assign(cell=name) for name in sorted(parts)], ignore_index=True)
    data = as_parquet(joined[["cell", *joined.columns.drop("cell")]])
    found = _by_cell(pd.read_parquet(io.BytesIO(data)))
    for name, rows in parts.items():  # a table may lack columns that others have
        if name not in found or not found[name][list(rows)].equals(rows.reset_index(drop=True)):
            raise UserError(f"{file} of {name} does not read back as it was: nothing was packed")
    return data


def as_parquet(table: pd.DataFrame) -> bytes:
    """The bytes of a stored table: the same for the same content."""
    return table.to_parquet(index=False, **COMPACT)
