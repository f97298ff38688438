"""All finished cells of a directory as tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.packed import read_packed
from experiments.study.store import (
    EPISODES,
    GATES,
    MARKS,
    TABLES,
    TRAINING,
    DamagedCell,
    check_results,
    finished,
    read_failures,
    read_stored,
    read_sweeps,
    read_table,
    weights_file,
)
from experiments.support.errors import UserError

if TYPE_CHECKING:
    import pandas as pd

# Columns of the key that every table of `Results` carries.
KEY_COLUMNS = ("cell", "kind", "backend", "task", "level", "level_name", "arm", "seed", "policy", "preset")


@dataclass(frozen=True)
class Results:
    """All finished cells of a directory as tidy tables.

    agents: one row a cell, trained agents and baselines alike (`kind`): KEY_COLUMNS, the profile's settings
        as columns (gamma, updates, ...; missing for baselines), and of the learner updates, episodes,
        q_bound, max_abs_q (largest on the probe states at any checkpoint), weights_sha256.
    episodes: one row a test episode: KEY_COLUMNS and the columns of `evaluate.COLUMNS`.
    gate_episodes: the same of the scenarios that the gates are judged on, with GATE_COLUMNS alone.
    training: one row a training episode: KEY_COLUMNS and episode, step, return, length, crashed, arrived,
        mean_speed, epsilon.
    marks: the same with MARK_COLUMNS, of the policies that agents had at the parts `grid.MARKS` of their budget (1, 2).
    cells: cell.json of each cell by name. failed: name and reason of the cells that were given up.
    expected: names of all cells that sweeps have asked for, finished or not (`read_sweeps`).
    damaged: name and reason of the cells that cannot be read, if they were to be passed over.
    """

    directory: Path
    agents: pd.DataFrame
    episodes: pd.DataFrame
    gate_episodes: pd.DataFrame
    training: pd.DataFrame
    marks: pd.DataFrame
    cells: dict[str, dict[str, Any]]
    failed: dict[str, str] = field(default_factory=dict)
    expected: tuple[str, ...] = ()
    damaged: dict[str, str] = field(default_factory=dict)

    def weights(self, cell: str) -> Path | None:
        """The file of an agent's weights; None if they are not here."""
        return weights_file(self.directory, cell)


def load(directory: Path, skip_damaged: bool = False) -> Results:
    """Read and check all finished cells of a directory.

    Args:
        skip_damaged: note damaged cells in `Results.damaged` and go on with the others.

    Raises:
        UserError: no result directory, or no finished cell in it.
        DamagedCell: a stored file is missing, unreadable or changed.
    """
    import pandas as pd

    directory = Path(directory)
    cells: dict[str, dict[str, Any]] = {}
    agents: list[dict[str, Any]] = []
    parts: dict[str, dict[str, pd.DataFrame]] = {file: {} for file in TABLES}  # by file, then by cell
    damaged: dict[str, str] = {}
    check_results(directory)
    packed = read_packed(directory)
    rows = {file: table for file in TABLES if (table := packed.table(file)) is not None}
    of_cell = {file: dict(iter(table.groupby("cell"))) for file, table in rows.items()}
    for name in finished(directory):
        path = directory / "cells" / name
        try:
            record = read_stored(directory, name)
            if path.is_dir():
                there = [file for file in TABLES if file in record["files"] and (path / file).exists()]
                tables = {file: read_table(path / file) for file in there}
            else:
                known = {file: rows[name] for file, rows in of_cell.items() if name in rows}
                tables = {file: rows.drop(columns="cell") for file, rows in known.items()}
        except DamagedCell as error:
            if not skip_damaged:
                raise
            damaged[name] = str(error)
            continue
        columns = {column: {**record["key"], "cell": name}.get(column) for column in KEY_COLUMNS}
        columns["preset"] = record["key"]["profile"].get("preset")
        cells[name] = record
        agents.append({**columns, **_scalars(record["key"]["profile"]), **_learner(record)})
        for file, table in tables.items():
            parts[file][name] = table
    if damaged and not cells:
        raise UserError(next(iter(damaged.values())))
    if not cells:
        raise UserError(f"{directory} holds no finished cell yet: run the sweep first")
    # A baseline has neither arm nor seed: types that know missing values keep seeds whole numbers.
    known = pd.DataFrame(agents).astype({"arm": "str", "seed": "Int64"})
    return Results(
        directory=directory,
        agents=known,
        episodes=_concatenate(parts[EPISODES], known),
        gate_episodes=_concatenate(parts[GATES], known),
        training=_concatenate(parts[TRAINING], known),
        marks=_concatenate(parts[MARKS], known),
        cells=cells,
        failed=read_failures(directory),
        expected=tuple(name for sweep in read_sweeps(directory) for name in sweep["cells"]),
        damaged=damaged,
    )


def _concatenate(tables: Mapping[str, pd.DataFrame], agents: pd.DataFrame) -> pd.DataFrame:
    """All rows of the tables of these cells, behind KEY_COLUMNS."""
    import pandas as pd

    keys = agents.set_index("cell", drop=False)[list(KEY_COLUMNS)]
    if not tables:
        return keys.iloc[:0].reset_index(drop=True)
    cells = [name for name, table in tables.items() for _ in range(len(table))]
    rows = pd.concat(tables.values(), ignore_index=True)
    if "actions" in rows:  # cells of earlier versions lack them
        rows["actions"] = rows["actions"].astype("str")
    return pd.concat([keys.loc[cells].reset_index(drop=True), rows], axis=1)


def _scalars(profile: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in profile.items() if not isinstance(value, list | dict)}


def _learner(record: Mapping[str, Any]) -> dict[str, Any]:
    learner = record.get("learner")
    if not learner:
        return {}
    probe = learner.get("probe_q", [])
    return {
        "updates": learner.get("updates"),
        "episodes": learner.get("episodes"),
        "q_bound": learner.get("q_bound"),
        # JSON knows no infinity: a diverged agent's value is stored as null
        "max_abs_q": max((math.inf if row[2] is None else row[2] for row in probe), default=None),
        "weights_sha256": learner.get("weights_sha256"),
    }
