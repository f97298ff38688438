"""A packing that is killed at any file operation: the folder can be read, and the same command packs it."""

from __future__ import annotations

import shutil
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


class Killed(BaseException):
    """Nothing happens on the disk after it, as after a kill: whatever is tried to clean up fails."""


class Killer:
    """Lets so many operations on the files of a folder happen, and none after them."""

    directory, left = "", 0

    def __call__(self, event: str, arguments: tuple[object, ...]) -> None:
        if self.directory and event in OPERATIONS and self._counts(str(arguments[0])):
            self.left -= 1
            if self.left < 0:
                raise Killed

    def _counts(self, path: str) -> bool:
        return self.directory in path and f"{self.directory}/cells" not in path  # these are only read

    def packs(self, directory: Path, operations: int) -> bool:
        """Whether a packing comes to its end before it is killed."""
        clear_caches()
        self.directory, self.left = str(directory), operations
        try:
            Store(directory).pack()
        except Killed:
            return False
        finally:
            self.directory = ""
        return True


@pytest.fixture(scope="module")
def killer() -> Killer:
    hook = Killer()
    sys.addaudithook(hook)  # for as long as the process lives
    return hook


def clear_caches() -> None:
    packed._records.cache_clear()
    packed._tables.cache_clear()


def content(directory: Path) -> pd.DataFrame:
    clear_caches()
    found = load(directory).episodes
    return found.sort_values(["cell", "traffic", "scenario"]).reset_index(drop=True)


def killed(original: Path, directory: Path, share: float, killer: Killer) -> Path:
    """A copy whose packing was killed after a share of its operations."""
    whole, many = directory.with_name("whole"), 10_000
    shutil.copytree(original, whole)
    assert killer.packs(whole, many)
    shutil.copytree(original, directory)
    assert not killer.packs(directory, int(share * (many - killer.left)))
    shutil.rmtree(whole)
    return directory


def assert_whole(directory: Path, expected: pd.DataFrame) -> None:
    """That a folder can be read, packed by the same command, and read without the cells' own folders."""
    pd.testing.assert_frame_equal(content(directory), expected)
    Store(directory).pack()
    shutil.rmtree(directory / "cells")
    pd.testing.assert_frame_equal(content(directory), expected)
    assert not list(directory.glob(".*.tmp"))


@pytest.mark.long
@pytest.mark.parametrize("kind", ["first", "later", "again"])
def test_every_kill(kind: str, folders: dict[str, Path], killer: Killer, tmp_path: Path) -> None:
    """As many kills as a packing has operations on files; "again": of one that repeats a killed one."""
    original = folders["first" if kind == "first" else "later"]
    before, operations, whole = content(original), 0, False
    if kind == "again":
        original = killed(original, tmp_path / "original", 0.6, killer)
    while not whole:
        directory = tmp_path / str(operations)
        shutil.copytree(original, directory)
        whole = killer.packs(directory, operations)
        assert_whole(directory, before)
        shutil.rmtree(directory)
        operations += 1
    print(f"{operations - 1} kills of a packing: {kind}")
    assert operations > 15


@pytest.mark.parametrize("kind", ["first", "later"])
@pytest.mark.parametrize("share", [0.5, 0.8])
def test_a_kill(kind: str, share: float, folders: dict[str, Path], killer: Killer, tmp_path: Path) -> None:
    """Some of these kills, between the first table and the last manifest."""
    before = content(folders[kind])
    assert_whole(killed(folders[kind], tmp_path / "killed", share, killer), before)
