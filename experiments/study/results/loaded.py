"""All finished cells of a directory: a table of the cells, which says what belongs together, and one of episodes.

Whoever compares, judges or counts cells asks the table (`Results.table`), so that there is one answer.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from experiments.study.design.cell import setting, test_of
from experiments.study.results.parquet import DamagedCell
from experiments.study.results.schema import COLUMNS, EPISODES, GATES
from experiments.study.results.store import Store
from experiments.support.errors import UserError

SETTING = ["backend", "task", "level", "level_name"]  # every comparison is made within a setting
AGENT = [*SETTING, "arm", "seed"]
# What every episode carries of its cell.
OF_CELL = ["cell", "kind", *AGENT, "policy", "preset", "tested_on"]


def table_of(cells: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Which cells belong together.

    Args:
        cells: the record of each by name.

    Returns:
        A row a cell, by its name: OF_CELL, where tested_on is the simulator of its test, and arm and seed are missing
        in baselines; setting (see `cell.setting`); who (its arm, or its policy); traffics, of its test. Cells of a
        setting with the same who and tested_on are there for the same in each traffic that they share.
    """
    rows = [
        {
            **(key := record["key"]),
            "cell": name,
            "preset": key["profile"].get("preset"),
            "tested_on": test_of(key)["backend"],
            "setting": setting(key),
            "who": key["arm"] or key["policy"],
            "traffics": tuple(test_of(key)["traffics"]),
        }
        for name, record in cells.items()
    ]
    # Types that know missing values keep seeds whole numbers.
    table = pd.DataFrame(rows, columns=[*OF_CELL, "setting", "who", "traffics"])
    return table.astype({"arm": "str", "seed": "Int64"}).set_index("cell", drop=False)


@dataclass(frozen=True)
class Results:
    """All finished cells of a directory as tidy tables.

    episodes: one row a test episode: OF_CELL and the columns of `schema.COLUMNS`.
    gate_episodes: the same of the scenarios that the gates are judged on.
    cells: the record of each cell by name. failed: what went wrong in those of `expected` that are not finished.
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

    @cached_property
    def table(self) -> pd.DataFrame:
        """Which cells belong together, see `table_of`."""
        return table_of(self.cells)

    @cached_property
    def order(self) -> dict[str, int]:
        """The places of cells in what sweeps have asked for; the last sweep stands last."""
        return {name: number for number, name in enumerate(self.expected)}


def load(directory: Path) -> Results:
    """Read and check all finished cells of a directory; damaged ones are named in `Results.damaged`.

    Raises:
        UserError: no result directory, no finished cell in it that can be read, or a damaged part.
    """
    store = Store(Path(directory))
    store.check()
    cells: dict[str, dict[str, Any]] = {}
    found: dict[str, dict[str, pd.DataFrame]] = {}
    damaged: dict[str, str] = {}
    for name in store.finished():
        try:
            cells[name], found[name] = store.record(name), store.tables(name)
        except DamagedCell as error:
            damaged[name] = str(error)
    expected = tuple(name for sweep in store.sweeps() for name in sweep["cells"])
    if not cells:
        reason = f"{directory} holds no finished cell yet: run the sweep first"
        raise UserError(next(iter(damaged.values()), reason))
    keys = table_of(cells)[OF_CELL]
    episodes, gates = (
        _concatenate({name: own[file] for name, own in found.items() if file in own}, keys)
        for file in (EPISODES, GATES)
    )
    return Results(
        directory=store.directory,
        episodes=episodes,
        gate_episodes=gates,
        cells=cells,
        # a cell that failed, and that no sweep asks for any more, says nothing of this study
        failed={name: why for name, why in store.failures().items() if name in expected},
        expected=expected,
        damaged=damaged,
    )


def _concatenate(tables: Mapping[str, pd.DataFrame], keys: pd.DataFrame) -> pd.DataFrame:
    """All rows of the tables of these cells, behind OF_CELL."""
    if not tables:  # of gates, where all that can be read was tested on another simulator
        return keys.iloc[:0].reset_index(drop=True)
    rows = pd.concat(tables, names=["cell"]).reset_index("cell")[["cell", *COLUMNS]]
    return keys.reset_index(drop=True).merge(rows, on="cell")
