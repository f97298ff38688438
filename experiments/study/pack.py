"""Pack finished cells into the tables of `packed`: nothing is deleted, and what is written is read back."""

from __future__ import annotations

import io
import json
import shutil
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.study.grid import setting
from experiments.study.packed import CELLS, LAYOUT, MANIFEST, Packed
from experiments.study.store import (
    COMPACT,
    TABLES,
    WEIGHTS,
    cell_directories,
    check_results,
    read_cell,
    read_sweeps,
    read_table,
)
from experiments.support.errors import UserError
from experiments.support.files import alone, sha256_bytes, write_file, write_json


def pack(directory: Path) -> tuple[list[str], dict[str, int]]:
    """Pack the cells of all finished settings that are not packed yet.

    Returns:
        Names of the cells that were packed now, and the number of missing cells of each setting that is not finished.

    Raises:
        UserError: no result directory, a damaged cell or table, or a cell that does not read back equal.
    """
    check_results(directory)
    with alone(directory):
        packed = Packed(directory)
        folders = {path.name: path for path in cell_directories(directory)}
        stored = {name: read_cell(path) for name, path in folders.items() if name not in packed.records}
        unfinished = _missing(directory, {**packed.records, **stored})
        records = {
            name: record for name, record in stored.items() if setting(record["key"]) not in unfinished
        }
        if not records:
            return [], unfinished
        own = {name: _tables(folders[name], record) for name, record in records.items()}
        everything = {**packed.records, **records}
        written = {CELLS: _index(everything)}
        for file in TABLES:
            parts = [tables[file].assign(cell=name) for name, tables in own.items() if file in tables]
            before = packed.table(file)
            parts += [] if before is None else [before]
            if parts:
                rows = pd.concat(parts, ignore_index=True).sort_values(
                    "cell", kind="stable", ignore_index=True
                )
                written[file] = rows[["cell", *rows.columns.drop("cell")]]
        contents = {file: _parquet(table) for file, table in written.items()}
        _check(contents, everything, own, packed)
        for name in records:
            if (folders[name] / WEIGHTS).exists():
                packed.weights(name).parent.mkdir(exist_ok=True)
                shutil.copyfile(folders[name] / WEIGHTS, packed.weights(name))
        _write(directory, contents, packed)
    return sorted(records), unfinished


def _missing(directory: Path, there: Mapping[str, Mapping[str, Any]]) -> dict[str, int]:
    """Number of cells that sweeps have asked for and that are not there, by setting."""
    settings = sorted({setting(record["key"]) for record in there.values()}, key=len, reverse=True)
    wanted = {name for sweep in read_sweeps(directory) for name in sweep["cells"]}
    missing = (
        next((known for known in settings if name.startswith(f"{known}-")), None)
        for name in wanted - there.keys()
    )
    return dict(Counter(known for known in missing if known is not None))


def _tables(folder: Path, record: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
    """The tables of a cell in a folder of its own, by file."""
    return {
        file: read_table(folder / file)
        for file in TABLES
        if file in record["files"] and (folder / file).exists()
    }


def _index(records: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """One row per cell; `record` is all of cell.json, the other columns are for people who read the table."""
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


def _parquet(table: pd.DataFrame) -> bytes:
    buffer = io.BytesIO()
    table.to_parquet(buffer, index=False, **COMPACT)
    return buffer.getvalue()


def _check(
    contents: Mapping[str, bytes],
    records: Mapping[str, Any],
    own: Mapping[str, Mapping[str, pd.DataFrame]],
    packed: Packed,
) -> None:
    """Read the new tables and compare them with what they were made of. Raises UserError."""
    back = {file: pd.read_parquet(io.BytesIO(data)) for file, data in contents.items()}
    index = back.pop(CELLS)
    found = {name: json.loads(text) for name, text in zip(index["cell"], index["record"], strict=True)}
    if found != records:
        raise UserError("the packed cell.json of some cells are not what they were: nothing was packed")
    for file, table in back.items():
        by_cell = {name: rows.drop(columns="cell") for name, rows in table.groupby("cell")}
        before = packed.table(file)
        expected = {name: tables[file] for name, tables in own.items() if file in tables}
        if before is not None:
            expected |= {name: rows.drop(columns="cell") for name, rows in before.groupby("cell")}
        if by_cell.keys() != expected.keys():
            raise UserError(f"the packed {file} has rows of other cells: nothing was packed")
        for name, rows in expected.items():
            same = (
                by_cell[name][list(rows.columns)].reset_index(drop=True).equals(rows.reset_index(drop=True))
            )
            if not same or by_cell[name][by_cell[name].columns.difference(rows.columns)].notna().any(
                axis=None
            ):
                raise UserError(f"{file} of {name} does not read back as it was: nothing was packed")


def _write(directory: Path, contents: Mapping[str, bytes], packed: Packed) -> None:
    """Replace the tables, the index last, so that what is there can be read after a kill at any moment."""
    new = {file: sha256_bytes(data) for file, data in contents.items()}
    either = {file: [digest, *packed.checksums.get(file, [])] for file, digest in new.items()}
    write_json(directory / MANIFEST, {"layout": LAYOUT, "files": either})
    for file in sorted(contents, key=lambda file: file == CELLS):
        write_file(directory / file, contents[file])
    write_json(
        directory / MANIFEST, {"layout": LAYOUT, "files": {file: [digest] for file, digest in new.items()}}
    )
