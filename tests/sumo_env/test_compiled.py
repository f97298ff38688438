"""Machine code is kept, and dropped when a kernel that another file calls has changed."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numba
import numpy as np
import pytest

from sumo_env.compiled import borrowing, compiled, drop_outdated


def test_code_older_than_any_kernel_is_dropped(tmp_path: Path) -> None:
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    for name, time in (("a.py", 100), ("b.py", 300), ("c.py", 900)):
        (tmp_path / name).write_text("")
        os.utime(tmp_path / name, (time, time))
    for name, time in (("a.f-1.py311.nbi", 200), ("b.g-1.py311.nbi", 400)):
        (cache / name).write_text("")
        os.utime(cache / name, (time, time))
    assert drop_outdated(tmp_path) == 1  # c.py holds no kernel, and does not count
    assert [path.name for path in cache.iterdir()] == ["b.g-1.py311.nbi"]
    assert drop_outdated(tmp_path) == 0


def test_without_a_place_for_machine_code_a_kernel_still_works(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = numba.njit

    def njit(*functions, **options):
        if options.pop("cache", False):
            raise_no_locator()
        return plain(*functions, **options)

    def raise_no_locator() -> None:
        raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")

    monkeypatch.setattr(numba, "njit", njit)
    assert compiled(lambda x: x + 1)(1) == 2
    assert borrowing(lambda x: x + 1)(1) == 2


def test_who_borrows_arrays_makes_none_and_leaves_their_references_as_they_were() -> None:
    array = np.ones((3, 2))
    before = sys.getrefcount(array)
    assert borrowed(array, 1) == 2.0
    assert sys.getrefcount(array) == before
    with pytest.raises(numba.core.errors.TypingError):
        borrowing(lambda n: np.empty(n))(3)
    assert makes(3) == 3.0
    assert borrows_from_one_that_makes(3) == 3.0


@borrowing
def borrowed(array, i):
    row = array[i]
    return row[0] + row[1]


@compiled
def makes(n):
    return np.ones(n).sum()


@borrowing
def borrows_from_one_that_makes(n):
    return makes(n)
