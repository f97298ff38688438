"""Parts: read as the cells were, written once, added to by others, whole after any kill, and named when damaged."""

import os
import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from experiments.study.design.presets import of_preset
from experiments.study.results import store
from experiments.study.results.loaded import load
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from experiments.sweep import Options, sweep
from tests.experiments.computed import TINY, damage, sweep_of
from tests.experiments.fake_env import make_env


def content(directory: Path) -> dict[str, Any]:
    """All results as one, and the training that no analysis reads."""
    home, results = Store(directory), load(directory)
    trained = [home.training(name).assign(cell=name) for name in home.agents()]
    return {**vars(results), store.TRAINING: pd.concat(trained)}


def assert_same(one: dict[str, Any], other: dict[str, Any]) -> None:
    for name in one:
        if isinstance(one[name], pd.DataFrame):
            pd.testing.assert_frame_equal(one[name], other[name], check_exact=True)
        elif name != "directory":
            assert one[name] == other[name], name


def test_packed_cells_are_read_as_they_were(results: Path) -> None:
    before = content(results)
    assert Store(results).pack() == sorted(before["cells"])
    assert not list((results / "cells").iterdir())
    assert [path.stem[:-9] for path in sorted((results / "parts").iterdir())] == ["sumo-u-turn-3"]
    assert_same(content(results), before)
    assert all(Store(results).weights(name) for name in Store(results).agents())
    assert Store(results).pack() == []


def test_a_part_is_a_table_that_anybody_can_read(results: Path) -> None:
    expected = load(results).episodes.groupby("cell")["distance"].max()
    Store(results).pack()
    found = pd.read_parquet(results / "parts").query("purpose == 'test'")
    assert found.groupby("cell")["distance"].max().to_dict() == expected.to_dict()


def test_a_sweep_goes_on_from_parts_which_are_never_written_again(
    results: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another seed is computed, tested elsewhere with its weights, and packed beside the others."""
    Store(results).pack()
    before = set(load(results).cells)
    parts = {path: (path.stat().st_ino, path.read_bytes()) for path in (results / "parts").iterdir()}
    options = of_preset(Options, out=results, **{**TINY, "dry_run": True, "seeds": 2})
    assert sweep(options, make_env=make_env, check=lambda _: None) == 0
    [row] = [line.split() for line in capsys.readouterr().out.splitlines() if line.startswith("u-turn")]
    assert row[5] == str(len(before))  # are finished
    sweep_of(results, seeds=2, test_on=("replica",))
    found = content(results)
    new = set(found["cells"]) - before
    kinds = sorted(cell["key"]["kind"] for name, cell in found["cells"].items() if name in new)
    assert kinds == 2 * ["agent"] + 4 * ["test"]
    assert len(list((results / "cells").iterdir())) == len(new)
    assert set(Store(results).pack()) == new
    assert_same(content(results), found)
    assert {path: (path.stat().st_ino, path.read_bytes()) for path in parts} == parts


def test_a_part_that_cannot_be_read_back_takes_no_cells_away(
    results: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual, cells = store.write_file, sorted((results / "cells").iterdir())
    monkeypatch.setattr(store, "write_file", lambda path, data: usual(path, data[: len(data) // 2]))
    with pytest.raises(UserError, match="damaged"):
        Store(results).pack()
    assert sorted((results / "cells").iterdir()) == cells


def test_a_damaged_part_is_named(results: Path) -> None:
    Store(results).pack()
    part = min((results / "parts").iterdir())
    damage(part, "cut")
    with pytest.raises(UserError, match=rf"{part.name} is damaged .*: restore it"):
        load(results)


def test_what_lies_beside_packed_cells_is_compared_with_its_checksum(results: Path) -> None:
    Store(results).pack()
    name = next(iter(Store(results).agents()))
    for read, path in ((Store.weights, f"weights/{name}.npz"), (Store.training, f"training/{name}.parquet")):
        damage(results / path, "changed")
        with pytest.raises(UserError, match="checksum does not match"):
            read(Store(results), name)


OPERATIONS = ("open", "os.rename", "os.remove", "os.mkdir")


def packs(directory: Path, operations: int) -> bool:
    """Pack in a process that is killed after so many operations on the folder's files; whether it came to its end."""
    left = operations

    def kill(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal left
        if event in OPERATIONS and str(directory) in str(arguments[0]):
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)

    pid = os.fork()
    if pid == 0:
        sys.addaudithook(kill)
        Store(directory).pack()
        os._exit(0)
    status = os.waitpid(pid, 0)[1]
    assert status in (0, signal.SIGKILL)
    return status == 0


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.long)])
def test_a_packing_that_is_killed_anywhere_loses_nothing_and_is_done_by_the_same_command(
    results: Path, tmp_path: Path, every: int
) -> None:
    sweep_of(results, levels=(2,))  # another part
    before, operations, whole = content(results), 0, False
    while not whole:
        directory = shutil.copytree(results, tmp_path / str(operations))
        whole = packs(directory, operations)
        assert_same(content(directory), before)
        Store(directory).pack()
        assert_same(content(directory), before)
        assert len(list((directory / "parts").glob("*.parquet"))) == 2
        assert not list((directory / "cells").iterdir())
        operations += every
    assert operations > 15
