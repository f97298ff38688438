"""Agents of both simulators, tested in both: every comparison is there, on the same scenarios."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from experiments.study.grid import BACKENDS
from experiments.support.errors import UserError
from experiments.transfer import COMPARED, Options, abroad, cells_of, transfer

EPISODES = 2


@pytest.mark.slow
def test_every_agent_is_tested_in_both_simulators_on_the_same_scenarios(tmp_path: Path) -> None:
    options = Options(tmp_path, tasks=("u-turn",), seeds=1, episodes=EPISODES, updates=60)
    table = transfer(options)
    agents = table[table["trained"] != ""]
    assert {(row.trained, row.tested, row.traffic) for row in agents.itertuples()} == {
        (trained, tested, traffic)
        for trained in BACKENDS
        for tested in BACKENDS
        for traffic in ("regular", "risky")
    }
    assert (agents["units"] == 1).all()
    assert (table.loc[table["trained"] == "", "units"] == EPISODES).all()
    assert np.isfinite(table["return"]).all()
    assert (tmp_path / "transfer.png").stat().st_size > 0

    files = [abroad(tmp_path, cell) for cell in cells_of(options) if cell.arm]
    before = {file: file.stat().st_mtime_ns for file in files}
    again = transfer(options)
    pd.testing.assert_frame_equal(again, table)
    assert {file: file.stat().st_mtime_ns for file in files} == before  # nothing was driven twice


def test_the_cells_are_control_agents_and_drivers_of_both_simulators() -> None:
    cells = cells_of(Options(Path("."), tasks=("highway", "intersection"), seeds=3))
    for backend in BACKENDS:
        for task in ("highway", "intersection"):
            own = [cell for cell in cells if (cell.backend, cell.task) == (backend, task)]
            assert [cell.seed for cell in own if cell.arm] == [0, 1, 2]
            assert {cell.risk for cell in own if cell.arm} == {0.0}
            assert [cell.policy for cell in own if not cell.arm] == list(COMPARED)


def test_an_unknown_task_is_an_error() -> None:
    with pytest.raises(UserError, match="highway"):
        cells_of(Options(Path("."), tasks=("higway",)))
