"""All finished cells of a directory as tables."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.store import (
    EPISODES,
    GATES,
    MARKS,
    TRAINING,
    DamagedCell,
    Store,
)
from experiments.support.errors import UserError

if TYPE_CHECKING:
    import pandas as pd

# Columns of the key that every table of `Results` carries.
KEY_COLUMNS = ("cell", "kind", "backend", "task", "level", "level_name", "arm", "seed", "policy", "preset")


@dataclass(frozen=True)
class Results:
    """All finished cells of a directory as tidy tables.

    agents: one row a cell, trained agents and baselines alike (`kind`): KEY_COLUMNS, the profile's entries
        as columns (gamma, updates, ...; missing for baselines), and of the learner updates, episodes,
        q_bound, max_abs_q (largest on the probe states at any checkpoint), weights_sha256.
    episodes: one row a test episode: KEY_COLUMNS and the columns of `evaluate.COLUMNS`.
    gate_episodes: the same of the scenarios that the gates are judged on, with GATE_COLUMNS alone.
    training: one row a training episode: KEY_COLUMNS and episode, step, return, length, crashed, arrived,
        mean_speed, epsilon.
    marks: the same with MARK_COLUMNS, of the policies that agents had at the parts `grid.MARKS` of their budget (1, 2).
    cells: cell.json of each cell by name. failed: name and reason of the cells that were given up.
    expected: names of all cells that sweeps have asked for, finished or not (`Store.sweeps`).
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
        return Store(self.directory).weights(cell)


def load(directory: Path, skip_damaged: bool = False) -> Results:
    """Read and check all finished cells of a directory.

    Args:
        skip_damaged: note damaged cells in `Results.damaged` and go on with the others.

    Raises:
        UserError: no result directory, or no finished cell in it.
        DamagedCell: a stored file is missing, unreadable or changed.
    """
    import pandas as pd

    store = Store(Path(directory))
    store.check()
    cells: dict[str, dict[str, Any]] = {}
    tables: dict[str, dict[str, pd.DataFrame]] = {}
    damaged: dict[str, str] = {}
    for name in store.finished():
        try:
            cells[name], tables[name] = store.record(name), store.tables(name)
        except DamagedCell as error:
            if not skip_damaged:
                raise
            damaged[name] = str(error)
    if not cells:
        reason = f"{directory} holds no finished cell yet: run the sweep first"
        raise UserError(next(iter(damaged.values()), reason))
    # A baseline has neither arm nor seed: types that know missing values keep seeds whole numbers.
    agents = pd.DataFrame([_row(name, record) for name, record in cells.items()])
    agents = agents.astype({"arm": "str", "seed": "Int64"})
    episodes, gates, training, marks = (
        _concatenate({name: own[file] for name, own in tables.items() if file in own}, agents)
        for file in (EPISODES, GATES, TRAINING, MARKS)
    )
    return Results(
        directory=store.directory,
        agents=agents,
        episodes=episodes,
        gate_episodes=gates,
        training=training,
        marks=marks,
        cells=cells,
        failed=store.failures(),
        expected=tuple(name for sweep in store.sweeps() for name in sweep["cells"]),
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


def _row(name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """A cell's row of `Results.agents`."""
    key, learner = {**record["key"], "cell": name}, record.get("learner")
    row = {column: key.get(column) for column in KEY_COLUMNS}
    row |= {column: value for column, value in key["profile"].items() if not isinstance(value, list | dict)}
    row["preset"] = key["profile"].get("preset")
    if learner:
        row |= {column: learner.get(column) for column in ("updates", "episodes", "q_bound")}
        # JSON knows no infinity: a diverged agent's value is stored as null
        largest = (math.inf if look[2] is None else look[2] for look in learner.get("probe_q", []))
        row |= {"max_abs_q": max(largest, default=None), "weights_sha256": learner.get("weights_sha256")}
    return row
