"""A packing whose process is killed at any file operation: the folder can be read, and the same command packs it."""

from __future__ import annotations

import os
import shutil
import signal
import sys
from pathlib import Path

import pandas as pd
import pytest

from experiments.study.results import packed
from experiments.study.results.store import Store, load
from tests.faults.corruptions import rewrite, small, unpacked, without

OPERATIONS = ("open", "os.rename", "os.remove", "os.mkdir", "os.listdir", "os.scandir")


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """By what is packed already: nothing, or all cells but two."""
    home = tmp_path_factory.mktemp("kills")
    small(home / "whole")
    rewrite(home / "whole", without(lambda key: key["seed"] == 0 or key["policy"] in ("idle", "careful")))
    unpacked(home / "first", home / "whole")
    shutil.copytree(home / "first", home / "later")
    aside = [home / "later" / "cells" / name for name in sorted(packed.packed_records(home / "whole"))[:2]]
    for cell in aside:
        cell.rename(home / cell.name)
    Store(home / "later").pack()
    shutil.rmtree(home / "later" / "cells")
    for cell in aside:
        cell.parent.mkdir(exist_ok=True)
        (home / cell.name).rename(cell)
    return {"first": home / "first", "later": home / "later"}


def packs(directory: Path, operations: int) -> bool:
    """Pack in a process that is killed after so many operations on the folder's files; whether it came to its end."""
    cells, left = f"{directory}/cells", operations  # the cells' own files are only read

    def kill(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal left
        if event in OPERATIONS and str(directory) in (path := str(arguments[0])) and cells not in path:
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)

    clear_caches()
    pid = os.fork()
    if pid == 0:
        sys.addaudithook(kill)
        Store(directory).pack()
        os._exit(0)
    status = os.waitpid(pid, 0)[1]
    assert status in (0, signal.SIGKILL)
    return status == 0


def clear_caches() -> None:
    packed._records.cache_clear()
    packed._tables.cache_clear()


def content(directory: Path) -> pd.DataFrame:
    clear_caches()
    found = load(directory).episodes
    return found.sort_values(["cell", "traffic", "scenario"]).reset_index(drop=True)


def assert_whole(directory: Path, expected: pd.DataFrame) -> None:
    """That a folder can be read, packed by the same command, and read without the cells' own folders."""
    pd.testing.assert_frame_equal(content(directory), expected)
    Store(directory).pack()
    shutil.rmtree(directory / "cells")
    pd.testing.assert_frame_equal(content(directory), expected)
    assert not list(directory.glob(".*.tmp"))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["first", "later", "again"])
def test_every_kill(kind: str, folders: dict[str, Path], tmp_path: Path) -> None:
    """As many kills as a packing has operations on files; "again": of one that repeats a killed one."""
    original = folders["first" if kind == "first" else "later"]
    before, operations, whole = content(original), 0, False
    if kind == "again":
        original = shutil.copytree(original, tmp_path / "original")
        assert not packs(original, 20)
    while not whole:
        directory = shutil.copytree(original, tmp_path / str(operations))
        whole = packs(directory, operations)
        assert_whole(directory, before)
        shutil.rmtree(directory)
        operations += 1
    print(f"{operations - 1} kills of a packing: {kind}")
    assert operations > 15


@pytest.mark.parametrize(("kind", "operations"), [("first", 9), ("first", 15), ("later", 17), ("later", 27)])
def test_a_kill(kind: str, operations: int, folders: dict[str, Path], tmp_path: Path) -> None:
    """Some of these kills, between the first table and the last manifest."""
    before = content(folders[kind])
    directory = shutil.copytree(folders[kind], tmp_path / "killed")
    assert not packs(directory, operations)
    assert_whole(directory, before)
