"""Finished cells on disk: written whole or not at all, checked when read, never computed twice.

DIR/cells/CELL.parquet     a finished cell: its test episodes and its record (see `parquet`)
DIR/parts/PART.parquet     the cells of a setting in one such file, which is written once (`Store.pack`)
DIR/weights/CELL.npz, DIR/training/CELL.parquet     of agents: their weights, and a row a training episode
DIR/work/CELL/             a cell in progress or given up: lock, log of what went wrong (see `run`)
DIR/damaged/               what was put aside because it was damaged
DIR/sweep.json             what sweeps have asked for

`Store` has one cell after the other, `loaded.load` all.
"""

import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from agents.plugins import sha256
from experiments.study.design.cell import RESULT_SCHEMA, Cell, setting
from experiments.study.results import parquet
from experiments.study.results.parquet import DamagedCell, DamagedPart, asked_of, unpacked
from experiments.study.results.schema import PURPOSES, SCHEMA, TRAINING, WEIGHTS, table_of
from experiments.study.results.working import last_words
from experiments.support.errors import UserError
from experiments.support.files import alone, made, read_json, sha256_bytes, write_file, write_json
from sumo_env.config import did_you_mean

SWEEPS = "sweep.json"
# Where an agent's other files lie.
BESIDE = {TRAINING: ("training", ".parquet"), WEIGHTS: ("weights", ".npz")}


class Store:
    """A result directory."""

    def __init__(self, directory: Path) -> None:
        self.directory = Path(directory)
        self.cells, self.parts, self.work = (self.directory / name for name in ("cells", "parts", "work"))

    def check(self) -> None:
        """Raise UserError if this is no directory of results."""
        if not (self.cells.is_dir() or self.parts.is_dir()):
            raise UserError(
                f"{self.directory} holds no results: name the --out directory of a sweep. Commits that have the cells"
                " of earlier studies are in results/FROZEN.md"
            )

    def finished(self) -> list[str]:
        """Names of all finished cells in alphabetical order."""
        # first: packing moves cells from here to parts
        own = [path.stem for path in self.cells.glob("*.parquet")]
        return sorted({*own, *self._packed()})

    def _own(self, name: str) -> Path:
        """The file of a cell that is not packed."""
        return self.cells / f"{name}.parquet"

    def _packed(self) -> dict[str, Path]:
        """The part of each packed cell, which can be read. Raises DamagedPart."""
        parts = sorted(self.parts.glob("*.parquet"))
        return {name: path for path in parts for name in asked_of(path, parquet.records, DamagedPart)}

    def _find(self, name: str, of: str) -> Any:
        """A cell's part of the "records" or "frames" of the file that it is in. Raises as `record` does."""
        own = self._own(name)
        if own.exists():
            found = asked_of(own, getattr(parquet, of), DamagedCell)
            if list(found) != [name]:
                raise DamagedCell(own, f"its content is that of {', '.join(found)}")
            return found[name]
        return asked_of(self._packed()[name], getattr(parquet, of), DamagedPart)[name]

    def record(self, name: str) -> dict[str, Any]:
        """The record of a finished cell. Raises DamagedCell; DamagedPart; KeyError without one."""
        return self._find(name, "records")

    def records(self) -> dict[str, dict[str, Any]]:
        """The records of all finished cells by name. Raises as `record` does."""
        return {name: self.record(name) for name in self.finished()}

    def agents(self) -> dict[str, dict[str, Any]]:
        """The records of the trained agents by name. Raises as `record` does, or UserError if there is none."""
        found = {name: record for name, record in self.records().items() if record["key"]["kind"] == "agent"}
        if not found:
            raise UserError(
                f"there is no trained agent in {self.directory}: python experiments/train.py --out results/mine"
            )
        return found

    def tables(self, name: str) -> dict[str, pd.DataFrame]:
        """EPISODES and, of a cell that is judged, GATES. Raises as `record` does."""
        return self._find(name, "frames")

    def training(self, name: str) -> pd.DataFrame:
        """An agent's training episodes. Raises DamagedCell; KeyError where they are not kept."""
        if (path := self._beside(name, TRAINING)) is None:
            raise KeyError(name)
        return asked_of(path, pd.read_parquet, DamagedCell)

    def weights(self, name: str) -> Path | None:
        """The file of an agent's weights; None if it is not here. Raises DamagedCell where they are others'."""
        return self._beside(name, WEIGHTS)

    def _beside(self, name: str, file: str) -> Path | None:
        folder, ending = BESIDE[file]
        path = self.directory / folder / f"{name}{ending}"
        if not path.exists():
            return None
        if asked_of(path, sha256, DamagedCell) != self.record(name)["files"].get(file):
            raise DamagedCell(path, "its checksum does not match")
        return path

    def is_whole(self, name: str) -> bool:
        """Whether a cell is stored; one that is not packed with all that belongs to it.

        Raises:
            DamagedCell: it has to be computed again. DamagedPart.
        """
        try:
            files = self.record(name)["files"]
            self.tables(name)
        except KeyError:
            return False
        for file in (file for file in BESIDE if file in files):
            if not self._beside(name, file) and self._own(name).exists():
                raise DamagedCell(self._own(name), f"its {file} is missing")
        return True

    def write(self, cell: Cell, record: Mapping[str, Any], files: Mapping[str, Any]) -> None:
        """Store a finished cell. What is written last makes it one.

        Args:
            record: timing, provenance and learner of the cell; the key, versions and checksums are added
                here.
            files: EPISODES and, where it is judged, GATES; of an agent also TRAINING (a data frame) and WEIGHTS (the
                path of the file).

        Raises:
            ValueError: it is not what a reader takes (`schema`). OSError: the disk is full or the directory cannot be
                written. It is not finished then.
        """
        table = table_of(cell.name, files)
        digests = {
            file: parquet.digest(table.filter(pc.equal(table["purpose"], purpose)))
            for file, purpose in PURPOSES.items()
            if file in files
        }
        beside: dict[str, bytes] = {}
        if TRAINING in files:
            beside[TRAINING] = files[TRAINING].to_parquet(index=False, compression="zstd")
        if WEIGHTS in files:
            beside[WEIGHTS] = files[WEIGHTS].read_bytes()
        value = {
            "schema": RESULT_SCHEMA,
            "key": cell.key(),
            "versions": cell.versions,
            "source": cell.source,
            **record,
            "files": digests | {file: sha256_bytes(data) for file, data in beside.items()},
        }
        content = parquet.content({cell.name: value}, table)
        if self._own(cell.name).exists():
            return  # somebody else has computed the same
        for file, data in beside.items():
            folder, ending = BESIDE[file]
            write_file(made(self.directory / folder) / f"{cell.name}{ending}", data)
        made(self.cells)
        write_file(self._own(cell.name), content)

    def sweeps(self) -> list[dict[str, Any]]:
        """The sweeps that have asked for cells, with `command` and the names of the `cells`, oldest first.

        Raises:
            UserError: the note cannot be read.
        """
        path = self.directory / SWEEPS
        try:
            noted = read_json(path)
            return [{"command": sweep["command"], "cells": sweep["cells"]} for sweep in noted["sweeps"]]
        except FileNotFoundError:
            return []
        except (OSError, ValueError, KeyError, TypeError) as error:
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

    def put_aside(self, name: str) -> Path:
        """Move the files of a damaged cell into a folder of its own in DIR/damaged, and return that."""
        folder = made(made(self.directory / "damaged") / f"{name}.{time.time_ns()}")
        beside = [self.directory / place / f"{name}{ending}" for place, ending in BESIDE.values()]
        for path in (self._own(name), *beside):
            with suppress(FileNotFoundError):  # another sweep was faster
                path.rename(folder / path.name)
        return folder

    def pack(self) -> list[str]:
        """Move the finished cells into parts, one for each setting; returns their names.

        A part is written once and read back before the files of its cells go. Cells that are finished later make a part
        of their own. A kill at any moment leaves each cell in at least one of both.

        Raises:
            UserError: no result directory, or a damaged cell or part.
        """
        self.check()
        with alone(self.directory):
            packed, groups = self._packed(), dict[str, list[str]]()
            own = sorted(path.stem for path in self.cells.glob("*.parquet"))
            for name in own:
                self.tables(name)
                groups.setdefault(setting(self.record(name)["key"]), []).append(name)
            for part, names in groups.items():
                if new := [name for name in names if name not in packed]:
                    path = made(self.parts) / f"{part}-{sha256_bytes(' '.join(new).encode())[:8]}.parquet"
                    rows = pa.concat_tables(unpacked(self._own(name), SCHEMA)[0] for name in new)
                    write_file(path, parquet.content({name: self.record(name) for name in new}, rows))
                    asked_of(path, parquet.frames, DamagedPart)
                for name in names:
                    self._own(name).unlink()
        return [name for name in own if name not in packed]


def of_other_weights(test: Mapping[str, Any], agent: Mapping[str, Any]) -> bool:
    """Whether a further test was of other weights than its agent has now, which was trained again; both are records."""
    return bool(test["tested"]["sha256"] != agent["files"].get(WEIGHTS))


def find_cell(word: str, names: Sequence[str]) -> str:
    """The cell with this name, with or without its hash, or the only one whose name begins so.

    Raises:
        UserError: none or several; the nearest one is named.
    """
    fitting = [name for name in names if word in (name, name.rpartition("-")[0])]
    fitting = fitting or [name for name in names if name.startswith(word)]
    if len(fitting) == 1:
        return fitting[0]
    hint = did_you_mean(word, fitting or names) or "write more of its name"
    raise UserError(f"{len(fitting)} of {len(names)} cells begin with {word!r}, not one: {hint}")
