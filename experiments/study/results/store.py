"""Finished cells on disk: written whole or not at all, checked when read, never computed twice; all of them as tables.

DIR/cells/<cell>/     cell.json, episodes.parquet; gates.parquet except in further tests of an agent; for agents also
                      training.parquet, weights.npz
DIR/packed.json, *.parquet, weights/   finished cells of which the folders may be removed (see `packed`)
DIR/work/<cell>/      a cell in progress or given up: lock, log of what went wrong (see `run`)
DIR/damaged/          what was put aside because it was damaged
DIR/sweep.json        what sweeps have asked for

`Store` has one cell after the other, `load` all of them as `Results`.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from agents.files import open_regular
from agents.schema import Wrong, check, parsed, shortened
from experiments.study.design.grid import RESULT_SCHEMA, Cell, setting
from experiments.study.results.packed import (
    MANIFEST,
    DamagedTable,
    add,
    as_parquet,
    packed_records,
    packed_tables,
    packed_weights,
    read_table,
)
from experiments.study.results.schema import (
    COLUMNS,
    EPISODES,
    GATES,
    check_episodes,
    check_record,
    check_rows,
)
from experiments.study.results.working import last_words
from experiments.support.errors import UserError
from experiments.support.files import (
    alone,
    made,
    publish,
    read_json,
    sha256_bytes,
    sha256_file,
    write_file,
    write_json,
)
from sumo_env.config import did_you_mean

CELL, TRAINING, WEIGHTS = "cell.json", "training.parquet", "weights.npz"
TABLES = (EPISODES, GATES, TRAINING)
SWEEPS = "sweep.json"
HEAD = '{\n "checksum": "%s",\n'  # of cell.json


class DamagedCell(UserError):
    """A stored cell that cannot be what was written; the message names the file and the remedy."""

    def __init__(self, file: Path, reason: str) -> None:
        super().__init__(
            f"{file} is damaged ({reason}): run the sweep again, which puts aside {file.parent} and computes it again"
        )
        self.file, self.reason = file, reason


class Store:
    """The result directory of an experiment, which need not exist to be asked what it holds.

    A finished cell has a folder of its own, or is packed with others; here the two are read alike.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.cells = directory / "cells"
        self.work = directory / "work"

    def check(self) -> None:
        """Raise UserError if this is no directory of results."""
        if not self.cells.is_dir() and not (self.directory / MANIFEST).exists():
            raise UserError(
                f"{self.directory} holds no results (neither {self.cells} nor {MANIFEST}): "
                "name the --out directory of a sweep"
            )

    def finished(self) -> list[str]:
        """Names of all finished cells in alphabetical order."""
        folders = self.cells.iterdir() if self.cells.is_dir() else ()
        return sorted({*(path.name for path in folders if path.is_dir()), *packed_records(self.directory)})

    def record(self, name: str) -> dict[str, Any]:
        """cell.json of a finished cell, after checking all its files. Raises DamagedCell, or KeyError without one."""
        path = self.cells / name
        return read_cell(path) if path.is_dir() else packed_records(self.directory)[name]

    def records(self) -> dict[str, dict[str, Any]]:
        """cell.json of all finished cells by name. Raises DamagedCell."""
        return {name: self.record(name) for name in self.finished()}

    def agents(self) -> dict[str, dict[str, Any]]:
        """cell.json of the trained agents by name. Raises DamagedCell, or UserError if there is none."""
        found = {name: record for name, record in self.records().items() if record["key"]["kind"] == "agent"}
        if not found:
            raise UserError(
                f"there is no trained agent in {self.directory}: python experiments/train.py --out {self.directory}"
            )
        return found

    def tables(self, name: str, wanted: Sequence[str] = TABLES) -> dict[str, pd.DataFrame]:
        """The tables of a finished cell that are here, by the names of their files. Raises DamagedCell."""
        path, record, found = self.cells / name, self.record(name), {}
        for file in (file for file in wanted if file in record["files"]):
            try:
                if path.is_dir():
                    found[file] = read_table(path / file)
                    check_episodes(file, found[file])
                elif name in (packed := packed_tables(self.directory, file)):
                    found[file] = packed[name]
                elif file != TRAINING:  # published folders lack them
                    raise Wrong("it has no rows")
                check_rows(record["key"], file, found.get(file, pd.DataFrame()))
            except Wrong as error:
                if path.is_dir():
                    raise DamagedCell(path / file, str(error)) from None
                raise DamagedTable(self.directory / file, f"{name}: {error}") from None
        return found

    def weights(self, name: str) -> Path | None:
        """The file of an agent's weights; None if it is not here."""
        own, packed = self.cells / name / WEIGHTS, packed_weights(self.directory, name)
        return own if own.exists() else packed if packed.exists() else None

    def write(self, cell: Cell, record: Mapping[str, Any], files: Mapping[str, Any]) -> None:
        """Store a finished cell in one step.

        Args:
            record: timing, provenance and learner of the cell; the key, versions and checksums are added
                here.
            files: data frames by name (parquet), or paths of files to take over.

        Raises:
            Wrong: it is not what a reader takes (`schema`). OSError: the disk is full or the directory cannot be
                written. Nothing is stored then.
        """
        staged = self.work / cell.name / f"finished-{socket.gethostname()}-{os.getpid()}"
        shutil.rmtree(staged, ignore_errors=True)
        made(staged.parent)
        staged.mkdir()
        for name, content in files.items():
            write_file(
                staged / name, content.read_bytes() if isinstance(content, Path) else as_parquet(content)
            )
        value = {
            "schema": RESULT_SCHEMA,
            "key": cell.key(),
            "versions": cell.versions,
            "source": cell.source,
            **record,
            "files": {name: sha256_file(staged / name) for name in sorted(files)},
        }
        check_record(cell.name, value)
        for name, content in files.items():
            if isinstance(content, pd.DataFrame):
                check_episodes(name, content)
                check_rows(value["key"], name, content)
        write_file(staged / CELL, seal(value))
        publish(staged, made(self.cells) / cell.name)

    def sweeps(self) -> list[dict[str, Any]]:
        """The sweeps that have asked for cells, with `command` and the names of the `cells`, oldest first.

        Raises:
            UserError: the note cannot be read.
        """
        path = self.directory / SWEEPS
        try:
            noted = read_json(path)
            check(noted, {"sweeps": [{"command": str, "cells": [str]}]})
            for sweep in noted["sweeps"]:
                if odd := [text for text in (sweep["command"], *sweep["cells"]) if not text.isprintable()]:
                    raise Wrong(f"it has characters that cannot be shown, in {shortened(odd[0])}")
            return [{"command": sweep["command"], "cells": sweep["cells"]} for sweep in noted["sweeps"]]
        except FileNotFoundError:
            return []
        except (OSError, ValueError) as error:
            reason = str(error).partition("\n")[0]
            raise UserError(
                f"{path} is damaged ({reason}): delete this file and run the sweep again"
            ) from None

    def write_sweep(self, command: str, cells: Sequence[Cell]) -> None:
        """Note what a sweep asks for.

        What earlier sweeps asked for stays, except cells of the same tasks and levels that were never finished.

        Raises:
            UserError: the note of earlier sweeps cannot be read.
            OSError: the directory cannot be made or written.
        """
        made(self.cells), made(self.work)
        wanted = dict.fromkeys(cell.name for cell in cells)
        settings = tuple({f"{setting(cell.key())}-" for cell in cells})
        with alone(self.directory):
            there = set(self.finished())

            def stays(name: str) -> bool:
                return name not in wanted and (name in there or not name.startswith(settings))

            before = [
                {**sweep, "cells": [name for name in sweep["cells"] if stays(name)]}
                for sweep in self.sweeps()
            ]
            sweeps = [sweep for sweep in before if sweep["cells"]]
            sweeps.append({"command": command, "cells": list(wanted)})
            write_json(self.directory / SWEEPS, {"sweeps": sweeps})

    def failures(self) -> dict[str, str]:
        """What went wrong last in the cells that are not finished, by name."""
        there = set(self.finished())
        words = {path.name: last_words(path) for path in sorted(self.work.glob("*"))}
        return {name: reason for name, reason in words.items() if reason and name not in there}

    def put_aside(self, path: Path) -> Path:
        """Move something damaged into DIR/damaged under a name of its own, and return that."""
        folder = made(self.directory / "damaged")
        target = folder / f"{'-'.join(path.relative_to(self.directory).parts[1:])}.{time.time_ns()}"
        with suppress(FileNotFoundError):  # another sweep was faster
            path.rename(target)
        return target

    def pack(self) -> list[str]:
        """Pack the finished cells that are not packed yet, see `packed.add`; returns their names.

        Raises:
            UserError: no result directory, or a damaged cell or table.
        """
        self.check()
        with alone(self.directory):
            for left in self.directory.glob(".*.tmp"):  # by a packing that was killed
                left.unlink()
            packed = packed_records(self.directory)
            new = {name: self.record(name) for name in self.finished() if name not in packed}
            weights = {name: self.cells / name / WEIGHTS for name in new}
            if new:
                add(
                    self.directory,
                    new,
                    {name: self.tables(name) for name in new},
                    {name: path for name, path in weights.items() if path.exists()},
                )
        return list(new)


def seal(record: Mapping[str, Any]) -> bytes:
    """A record as readable JSON whose first entry is the checksum of all bytes that follow."""
    body = json.dumps(record, indent=1, allow_nan=False).removeprefix("{\n") + "\n"
    return (HEAD % sha256_bytes(body.encode()) + body).encode()


def read_cell(path: Path) -> dict[str, Any]:
    """cell.json of a stored cell, after checking all its files against their checksums.

    Raises:
        DamagedCell: a file is missing, unreadable or changed.
    """
    file = path / CELL
    try:
        with open_regular(file) as opened:
            data = opened.read()
        begin = len(HEAD % ("0" * 64))
        if data[:begin] != (HEAD % sha256_bytes(data[begin:])).encode():
            raise DamagedCell(file, "its checksum does not match")
        record: dict[str, Any] = parsed(data)
        del record["checksum"]
        check_record(path.name, record)
        for file, checksum in ((path / name, checksum) for name, checksum in record["files"].items()):
            found = sha256_file(file)
            if found != checksum:
                raise DamagedCell(file, "its checksum does not match")
    except OSError as error:
        raise DamagedCell(file, error.strerror or "unreadable") from None
    except (ValueError, TypeError) as error:
        raise DamagedCell(file, str(error)) from None
    return record


def find_cell(word: str, names: Sequence[str]) -> str:
    """The cell with this name, with or without its hash, or the only one whose name begins so.

    Raises:
        UserError: none or several; the nearest one is named.
    """
    fitting = [name for name in names if word in (name, name.rpartition("-")[0])]
    fitting = fitting or [name for name in names if name.startswith(word)]
    if len(fitting) == 1:
        return fitting[0]
    hint = did_you_mean(word, fitting or names)
    raise UserError(f"{len(fitting)} of {len(names)} cells begin with {word!r}, not one; {hint}")


# Columns of the key that every table of `Results` carries.
KEY_COLUMNS = ("cell", "kind", "backend", "task", "level", "level_name", "arm", "seed", "policy", "preset")


@dataclass(frozen=True)
class Results:
    """All finished cells of a directory as tidy tables.

    episodes: one row a test episode: KEY_COLUMNS and the columns of `evaluate.COLUMNS`.
    gate_episodes: the same of the scenarios that the gates are judged on, with GATE_COLUMNS alone.
    cells: cell.json of each cell by name. failed: what went wrong in cells that are not finished, by name.
    expected: names of all cells that sweeps have asked for, finished or not (`Store.sweeps`).
    damaged: why cells cannot be read, by name.
    """

    directory: Path
    episodes: pd.DataFrame
    gate_episodes: pd.DataFrame
    cells: dict[str, dict[str, Any]]
    failed: dict[str, str] = field(default_factory=dict)
    expected: tuple[str, ...] = ()
    damaged: dict[str, str] = field(default_factory=dict)


def load(directory: Path) -> Results:
    """Read and check all finished cells of a directory; damaged ones are named in `Results.damaged`.

    Raises:
        UserError: no result directory, no finished cell in it that can be read, or a damaged packed table.
    """
    store = Store(Path(directory))
    store.check()
    cells: dict[str, dict[str, Any]] = {}
    tables: dict[str, dict[str, pd.DataFrame]] = {}
    damaged: dict[str, str] = {}
    for name in store.finished():
        try:
            cells[name], tables[name] = store.record(name), store.tables(name, (EPISODES, GATES))
        except DamagedCell as error:
            damaged[name] = str(error)
    if not cells:
        reason = f"{directory} holds no finished cell yet: run the sweep first"
        raise UserError(next(iter(damaged.values()), reason))
    keys = pd.DataFrame(
        [
            {**record["key"], "cell": name, "preset": record["key"]["profile"].get("preset")}
            for name, record in cells.items()
        ],
        columns=list(KEY_COLUMNS),
    )
    # A baseline has neither arm nor seed: types that know missing values keep seeds whole numbers.
    keys = keys.astype({"arm": "str", "seed": "Int64"}).set_index("cell", drop=False)
    episodes, gates = (
        _concatenate({name: own[file] for name, own in tables.items() if file in own}, keys)
        for file in (EPISODES, GATES)
    )
    return Results(
        directory=store.directory,
        episodes=episodes,
        gate_episodes=gates,
        cells=cells,
        failed=store.failures(),
        expected=tuple(name for sweep in store.sweeps() for name in sweep["cells"]),
        damaged=damaged,
    )


def _concatenate(tables: Mapping[str, pd.DataFrame], keys: pd.DataFrame) -> pd.DataFrame:
    """All rows of the tables of these cells, behind KEY_COLUMNS."""
    if not tables:
        return keys.iloc[:0].reset_index(drop=True)
    cells = [name for name, table in tables.items() for _ in range(len(table))]
    rows = pd.concat(tables.values(), ignore_index=True)
    rows = rows[[name for name in COLUMNS if name in rows]]
    if "actions" in rows:  # cells of earlier versions lack them
        rows["actions"] = rows["actions"].astype("str")
    return pd.concat([keys.loc[cells].reset_index(drop=True), rows], axis=1)
