"""Finished cells on disk: written whole or not at all, checked when read, never computed twice.

DIR/cells/<cell>/     cell.json, episodes.parquet; gates.parquet except in further tests of an agent; for agents also
                      training.parquet, marks.parquet (tests at parts of the budget), weights.npz
DIR/packed.json, *.parquet, weights/   finished cells of which the folders may be removed (see `packed`)
DIR/work/<cell>/      a cell in progress: checkpoint, lock, log (see `run`); failed.json if it was given up
DIR/damaged/          what was put aside because it was damaged
DIR/sweep.json        what sweeps have asked for
DIR/PUBLISHED.md      its heading is the name of DIR in reports

`results` reads all of it as tables.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.grid import RESULT_SCHEMA, Cell, cell_name, setting
from experiments.study.packed import MANIFEST, add, as_parquet, read_packed
from experiments.support.errors import UserError
from experiments.support.files import alone, publish, sha256_bytes, sha256_file, write_file, write_json

if TYPE_CHECKING:
    import pandas as pd

CELL, EPISODES, GATES = "cell.json", "episodes.parquet", "gates.parquet"
TRAINING, MARKS, WEIGHTS = "training.parquet", "marks.parquet", "weights.npz"
TABLES = (EPISODES, GATES, TRAINING, MARKS)
FAILED, SWEEPS, PUBLISHED = "failed.json", "sweep.json", "PUBLISHED.md"
# Columns of gates.parquet and marks.parquet, all that is analysed of those episodes.
_JUDGED = "traffic scenario return length crashed mean_speed distance near_misses"
GATE_COLUMNS = (*_JUDGED.split(), *(f"action_{number}" for number in range(5)))
MARK_COLUMNS = ("mark", *_JUDGED.split(), "crash_time")
HEAD = '{\n "checksum": "%s",\n'  # of cell.json


class DamagedCell(UserError):
    """A stored cell that cannot be what was written; the message names the file and the remedy."""

    def __init__(self, file: Path, reason: str) -> None:
        super().__init__(
            f"{file} is damaged ({reason}): run the sweep again, which puts aside {file.parent} and computes it again"
        )
        self.file, self.reason = file, reason


class Store:
    """The result directory of an experiment, to be written.

    Raises:
        OSError: it cannot be made or written.
    """

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.cells = directory / "cells"
        self.work = directory / "work"
        for path in (self.cells, self.work):
            path.mkdir(parents=True, exist_ok=True)

    def is_finished(self, cell: Cell) -> bool:
        """Whether the cell is stored, after checking that it is undamaged.

        Raises:
            DamagedCell: a file is missing, unreadable or changed.
        """
        path = self.cells / cell.name
        if path.is_dir():
            read_cell(path)
            return True
        return cell.name in read_packed(self.directory).records

    def write(self, cell: Cell, record: Mapping[str, Any], files: Mapping[str, Any]) -> None:
        """Store a finished cell in one step.

        Args:
            record: timing, provenance and learner of the cell; the key, versions and checksums are added
                here.
            files: data frames by name (parquet), or paths of files to take over.

        Raises:
            OSError: the disk is full or the directory cannot be written; nothing is stored then.
        """
        staged = self.work / cell.name / f"finished-{socket.gethostname()}-{os.getpid()}"
        shutil.rmtree(staged, ignore_errors=True)
        staged.mkdir(parents=True)
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
        write_file(staged / CELL, seal(value))
        publish(staged, self.cells / cell.name)

    def write_sweep(self, command: str, cells: Sequence[Cell]) -> None:
        """Note what a sweep asks for.

        What earlier sweeps asked for stays, except cells of the same tasks and levels that were never finished.

        Raises:
            UserError: the note of earlier sweeps cannot be read.
        """
        wanted = dict.fromkeys(cell.name for cell in cells)
        settings = tuple({f"{cell.setting}-" for cell in cells})
        with alone(self.directory):
            there = set(finished(self.directory))

            def stays(name: str) -> bool:
                return name not in wanted and (name in there or not name.startswith(settings))

            before = [
                {**sweep, "cells": [name for name in sweep["cells"] if stays(name)]}
                for sweep in read_sweeps(self.directory)
            ]
            sweeps = [sweep for sweep in before if sweep["cells"]]
            sweeps.append({"command": command, "cells": list(wanted)})
            write_json(self.directory / SWEEPS, {"sweeps": sweeps})

    def write_failure(self, name: str, reason: str, command: str) -> None:
        """Note that a cell was given up, and the command that tries it alone."""
        (self.work / name).mkdir(exist_ok=True)
        write_json(self.work / name / FAILED, {"reason": reason, "command": command})

    def forget(self, name: str, finished: bool) -> None:
        """Remove what earlier sweeps left of a cell: the note of a failure, and all of it if the cell is finished."""
        if finished:
            shutil.rmtree(self.work / name, ignore_errors=True)
        else:
            (self.work / name / FAILED).unlink(missing_ok=True)

    def put_aside(self, path: Path) -> Path:
        """Move something damaged to a name of its own in DIR/damaged, and return that."""
        folder = self.directory / "damaged"
        folder.mkdir(exist_ok=True)
        name, number = "-".join(path.relative_to(self.directory).parts[1:]), 1
        while (target := folder / f"{name}.{number}").exists():
            number += 1
        with suppress(FileNotFoundError):  # another sweep was faster
            path.rename(target)
        return target


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
        data = file.read_bytes()
        begin = len(HEAD % ("0" * 64))
        if data[:begin] != (HEAD % sha256_bytes(data[begin:])).encode():
            raise DamagedCell(file, "its checksum does not match")
        record: dict[str, Any] = json.loads(data)
        del record["checksum"]
        if (name := cell_name(record["key"], record["versions"])) != path.name:
            raise DamagedCell(file, f"its content is that of {name}")
        for file, checksum in ((path / name, checksum) for name, checksum in record["files"].items()):
            found = sha256_file(file)
            if found != checksum:
                raise DamagedCell(file, "its checksum does not match")
    except OSError as error:
        raise DamagedCell(file, error.strerror or "unreadable") from None
    return record


def cell_directories(directory: Path) -> list[Path]:
    """The directories of the finished cells that have one, in order of their names."""
    cells = directory / "cells"
    return sorted(path for path in cells.iterdir() if path.is_dir()) if cells.is_dir() else []


def finished(directory: Path) -> list[str]:
    """Names of all finished cells, packed or not, in alphabetical order; none if there are no results."""
    return sorted({*(path.name for path in cell_directories(directory)), *read_packed(directory).records})


def check_results(directory: Path) -> None:
    """Raise UserError if a directory is not one of results."""
    if not (directory / "cells").is_dir() and not (directory / MANIFEST).exists():
        raise UserError(
            f"{directory} holds no results (neither {directory / 'cells'} nor {MANIFEST}): "
            "name the --out directory of a sweep"
        )


def read_stored(directory: Path, name: str) -> dict[str, Any]:
    """cell.json of a finished cell, packed or not, checked. Raises DamagedCell, or KeyError if there is none."""
    path = directory / "cells" / name
    return read_cell(path) if path.is_dir() else read_packed(directory).records[name]


def tables_of(directory: Path, name: str) -> dict[str, pd.DataFrame]:
    """The tables of a finished cell that are here, by the names of their files. Raises DamagedCell."""
    import pandas as pd

    path = directory / "cells" / name
    if not path.is_dir():
        return read_packed(directory).tables(name)
    files = read_cell(path)["files"]
    return {file: pd.read_parquet(path / file) for file in TABLES if file in files}


def weights_file(directory: Path, name: str) -> Path | None:
    """The file of an agent's weights, packed or not; None if they are not here."""
    own, packed = directory / "cells" / name / WEIGHTS, read_packed(directory).weights(name)
    return own if own.exists() else packed if packed.exists() else None


def read_sweeps(directory: Path) -> list[dict[str, Any]]:
    """The sweeps that have asked for cells of a directory, with `command` and the names of the `cells`, oldest first.

    Raises:
        UserError: the note cannot be read.
    """
    path = directory / SWEEPS
    try:
        sweeps = json.loads(path.read_text())["sweeps"]
        return [{"command": sweep["command"], "cells": list(sweep["cells"])} for sweep in sweeps]
    except FileNotFoundError:
        return []
    except (ValueError, KeyError, TypeError) as error:
        reason = str(error).partition("\n")[0]
        raise UserError(f"{path} is damaged ({reason}): delete this file and run the sweep again") from None


def read_failures(directory: Path) -> dict[str, str]:
    """Name and reason of the cells that were given up and are not finished since."""
    failures = {}
    there = set(finished(directory))
    for path in sorted(directory.glob(f"work/*/{FAILED}")):
        if path.parent.name not in there:
            with suppress(
                ValueError, KeyError, TypeError
            ):  # a note that was cut off: the cell counts as missing
                failures[path.parent.name] = str(json.loads(path.read_text())["reason"])
    return failures


def pack(directory: Path) -> tuple[list[str], dict[str, int]]:
    """Pack the cells of all finished settings that are not packed yet; see `packed.add`.

    Returns:
        Names of the cells that were packed now, and the number of missing cells of each setting that is not finished.

    Raises:
        UserError: no result directory, or a damaged cell or table.
    """
    check_results(directory)
    with alone(directory):
        there = {name: read_stored(directory, name) for name in finished(directory)}
        settings = {setting(record["key"]) for record in there.values()}
        wanted = {name for sweep in read_sweeps(directory) for name in sweep["cells"]}
        # The longest setting with which a name begins: that of a cell may be the beginning of another's.
        of = {
            name: max((known for known in settings if name.startswith(f"{known}-")), key=len, default="")
            for name in wanted - there.keys()
        }
        missing = dict(Counter(filter(None, of.values())))
        packed = read_packed(directory).records
        new = [name for name in there if name not in packed and setting(there[name]["key"]) not in missing]
        files = {name: directory / "cells" / name / WEIGHTS for name in new}
        if new:
            add(
                directory,
                {name: there[name] for name in new},
                {name: tables_of(directory, name) for name in new},
                {name: path for name, path in files.items() if path.exists()},
            )
    return new, missing
