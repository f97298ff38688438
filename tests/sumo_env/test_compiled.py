"""Machine code is kept, and dropped when a kernel that another file calls has changed."""

from __future__ import annotations

import os
from pathlib import Path

import numba
import pytest

import sumo_env.compiled
from sumo_env.compiled import compiled, drop_outdated


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
    def njit(function=None, **options):
        if options.get("cache"):
            raise_no_locator()
        return numba.njit(function) if function else njit

    def raise_no_locator() -> None:
        raise RuntimeError("cannot cache function 'f': no locator available for file 'f.py'")

    monkeypatch.setattr(sumo_env.compiled, "njit", njit)
    assert compiled(lambda x: x + 1)(1) == 2
