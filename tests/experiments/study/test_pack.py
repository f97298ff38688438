"""Packed cells: equal to what they were, read in their place, packed again with later ones, and named when damaged."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from experiments.study.results import packed, store
from experiments.study.results.packed import CELLS, MANIFEST
from experiments.study.results.store import load
from experiments.support.errors import UserError
from experiments.sweep import Options, sweep
from tests.experiments.computed import TINY, damage, sweep_of, tasks_of
from tests.experiments.fake_env import make_env


def pack(results: Path) -> list[str]:
    """Pack the cells that are not, and leave the packed ones alone; returns the names of what was packed."""
    names = store.Store(results).pack()
    shutil.rmtree(results / "cells", ignore_errors=True)
    return names


def content(directory: Path) -> dict[str, Any]:
    """All results as one, and the tables that no analysis reads."""
    home, results = store.Store(directory), load(directory)
    tables = {name: home.tables(name) for name in results.cells}
    trained = [own[store.TRAINING].assign(cell=name) for name, own in tables.items() if store.TRAINING in own]
    return {**vars(results), store.TRAINING: pd.concat(trained)}


def assert_same(one: dict[str, Any], other: dict[str, Any]) -> None:
    for name in one:
        if isinstance(one[name], pd.DataFrame):
            pd.testing.assert_frame_equal(one[name], other[name], check_exact=True)
        elif name != "directory":
            assert one[name] == other[name], name


def test_packed_cells_are_read_as_they_were_and_nothing_is_deleted(results: Path) -> None:
    before, files = content(results), {path for path in results.rglob("*") if path.is_file()}
    assert store.Store(results).pack() == sorted(before["cells"])
    assert files < {path for path in results.rglob("*") if path.is_file()}
    assert_same(content(results), before)
    shutil.rmtree(results / "cells")
    assert_same(content(results), before)
    agents = [name for name, cell in before["cells"].items() if cell["key"]["kind"] == "agent"]
    assert all(store.Store(results).weights(name) is not None for name in agents)
    assert store.Store(results).pack() == []


def test_a_sweep_goes_on_from_packed_cells(results: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Another seed is computed, tested elsewhere with weights that are packed, and packed with the others."""
    pack(results)
    before = set(load(results).cells)
    options = Options(out=results, **{**TINY, "dry_run": True, "seeds": 2})
    assert sweep(options, make_env=make_env, check=lambda _: None) == 0
    [row] = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("u-turn")]
    assert row[5] == str(len(before))  # are finished
    sweep_of(results, seeds=2, test_on=("replica",))
    found = content(results)
    new = set(found["cells"]) - before
    kinds = sorted(cell["key"]["kind"] for name, cell in found["cells"].items() if name in new)
    assert kinds == 2 * ["agent"] + 4 * ["test"]
    assert len(list((results / "cells").iterdir())) == len(new)
    assert set(pack(results)) == new
    assert_same(content(results), found)


@pytest.mark.parametrize("file", [CELLS, store.EPISODES, store.GATES])
def test_a_damaged_table_is_named(results: Path, file: str) -> None:
    pack(results)
    damage(results / file, "changed")
    with pytest.raises(UserError, match=f"{file} is damaged .its checksum does not match.: restore it"):
        load(results)


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ('{"layout": 99, "files": {}}', "is of layout 99, and this version reads layout 1"),
        ('{"layout": 1}', "is damaged"),
        ("[", "is damaged"),
    ],
)
def test_an_unknown_or_damaged_manifest_is_named(results: Path, manifest: str, message: str) -> None:
    store.Store(results).pack()
    (results / MANIFEST).write_text(manifest)
    with pytest.raises(UserError, match=message):
        load(results)


def test_what_does_not_read_back_equal_is_not_believed(results: Path, monkeypatch) -> None:
    to_parquet = packed.as_parquet
    monkeypatch.setattr(
        packed, "as_parquet", lambda table: to_parquet(table.assign(length=1) if "length" in table else table)
    )
    with pytest.raises(UserError, match="does not read back as it was: nothing was packed"):
        store.Store(results).pack()
    assert not (results / MANIFEST).exists()


def test_cells_of_earlier_versions_have_no_actions_and_pack_with_others(results: Path) -> None:
    """Their tables lack the column; beside others it is missing there."""
    home = store.Store(results)
    [old] = [task for task in tasks_of(results) if task.cell.policy == "idle"]
    tables = home.tables(old.name)
    tables[store.EPISODES] = tables[store.EPISODES].drop(columns="actions")
    shutil.rmtree(home.cells / old.name)
    home.write(old.cell, {}, tables)
    before = content(results)
    assert before["episodes"]["actions"].isna().sum() == 6
    pack(results)
    assert_same(content(results), before)
