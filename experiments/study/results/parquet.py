"""Files of results: rows of a schema, a text that says what they are, and a checksum of both.

`packed` writes and `unpacked` reads every such file, whole or not at all: those of cells, and those of other episodes.
They are parquet files, whose metadata has the text as "records" and the checksum as "sha256". Nothing in them is
unpickled, and none is believed once a byte of it has changed.

A file of cells has the test episodes of one or of several as rows of `schema.SCHEMA`; its text is JSON, the record of
each cell by name.
"""

import hashlib
import io
import json
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from experiments.study.results.schema import (
    PURPOSES,
    SCHEMA,
    OtherVersion,
    as_table,
    check_record,
    check_table,
    schema_of,
)
from experiments.support.errors import UserError
from experiments.support.files import made, write_file

T = TypeVar("T")


class Damaged(UserError):
    """A file that cannot be what was written; the message names it and the remedy."""

    remedy: str

    def __init__(self, file: Path, reason: str, is_whole: bool = False) -> None:
        super().__init__(f"{file} {reason}" if is_whole else f"{file} is damaged ({reason}): {self.remedy}")
        self.file, self.reason = file, reason


class DamagedCell(Damaged):
    """A stored cell, which can be computed again."""

    remedy = "run the sweep again, which puts it aside and computes its cell again"


class DamagedPart(Damaged):
    """A part with the cells of several."""

    remedy = (
        "restore it from a copy (git checkout, for a published one), or remove it, and the same sweep computes its "
        "cells again"
    )


class DamagedEpisodes(Damaged):
    """Episodes that can be driven again."""

    remedy = "run the same command again, which drives its episodes again"


def asked_of(path: Path, asked: Callable[[Path], T], damaged: type[Damaged]) -> T:
    """What is asked of a file. Raises `damaged`, whatever a reader stumbles over."""
    try:
        return asked(path)
    except Exception as error:
        reason = error.strerror if isinstance(error, OSError) else str(error).partition("\n")[0]
        reason = reason or f"it cannot be read: {type(error).__name__}"
        raise damaged(path, reason, is_whole=isinstance(error, OtherVersion)) from None


def content(records: Mapping[str, Mapping[str, Any]], table: pa.Table) -> bytes:
    """The bytes of a file with these cells. Raises ValueError where it could not be read."""
    for name, record in records.items():
        check_record(name, record)
    check_table(table, records)
    return packed(table, json.dumps(records, allow_nan=False))


def packed(table: pa.Table, text: str) -> bytes:
    """The bytes of a file with these rows and this text."""
    data = io.BytesIO()
    with pq.ParquetWriter(
        data, table.schema, compression="zstd", write_statistics=False, store_schema=False
    ) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({"records": text, "sha256": digest(table, text)})
    return data.getvalue()


def digest(table: pa.Table, text: str = "") -> str:
    """SHA-256 of the values of a table, however they are stored, and of a text."""
    found = hashlib.sha256(text.encode())
    for name in table.column_names:
        column = table[name]
        if pa.types.is_string(column.type):
            words = column.to_pylist()
            lengths = [-1 if word is None else len(word) for word in words]
            found.update("".join(filter(None, words)).encode())
            values = np.array(lengths, dtype=np.int64)
        else:
            values = column.to_numpy()
        found.update(f"{name} {column.type} {len(column)}".encode() + np.ascontiguousarray(values).tobytes())
    return found.hexdigest()


def records(path: Path) -> dict[str, dict[str, Any]]:
    """The records in a file by name. Raises ValueError; OSError."""
    return _records(path, *_state(path))


def frames(path: Path) -> dict[str, dict[str, pd.DataFrame]]:
    """The tables in a file, by cell and by name, compared with its checksum. Raises ValueError; OSError."""
    return _frames(path, *_state(path))


def _state(path: Path) -> tuple[int, int, int]:
    about = path.stat()
    return about.st_ino, about.st_mtime_ns, about.st_size


@lru_cache(2**16)  # more than a sweep has cells
def _records(path: Path, *state: int) -> dict[str, dict[str, Any]]:
    text, _ = _metadata(pq.read_metadata(path))
    found: dict[str, dict[str, Any]] = json.loads(text)
    for name, record in found.items():
        check_record(name, record)
    return found


@lru_cache(8)
def _frames(path: Path, *state: int) -> dict[str, dict[str, pd.DataFrame]]:
    found = _records(path, *state)
    rows = check_table(unpacked(path, SCHEMA)[0], found)
    return {
        name: {
            file: rows[name, purpose].drop(columns=["cell", "purpose"]).reset_index(drop=True)
            for file, purpose in PURPOSES.items()
            if (name, purpose) in rows
        }
        for name in found
    }


def unpacked(path: Path, schema: pa.Schema) -> tuple[pa.Table, str]:
    """The rows and the text of a file, compared with its checksum. Raises ValueError, or as pyarrow does."""
    with pq.ParquetFile(path) as parquet:
        text, expected = _metadata(parquet.metadata)
        columns = parquet.schema_arrow.remove_metadata()
        if columns != schema:
            odd = [str(field) for field in schema if field not in columns] or columns.names
            words = ", ".join(odd[:3])
            raise OtherVersion(
                f"has other columns than this version writes ({words}): the version that wrote it reads it"
            )
        table = parquet.read()
    if digest(table, text) != expected:
        raise ValueError("its checksum does not match")
    return table, text


def _metadata(about: pq.FileMetaData) -> tuple[str, str]:
    """The text of the records, and the checksum."""
    metadata = about.metadata or {}
    if not metadata.keys() >= {b"records", b"sha256"}:
        raise ValueError("it has no records")
    return metadata[b"records"].decode(), metadata[b"sha256"].decode()


# -- Files of episodes that are no cells: batches, and the record of takeover.py ---------------------------------------


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
