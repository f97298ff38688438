"""``python -m sumo_env.doctor``: what it says, and with which exit status."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest

import sumo_env
from sumo_env import doctor
from tests.processes import python


def test_the_folder_is_named() -> None:
    out = io.StringIO()
    assert doctor.examine((), out) == 0
    assert str(Path(sumo_env.__file__).parent) in out.getvalue()


@pytest.mark.slow
def test_a_sound_installation_passes() -> None:
    said = python("-m", "sumo_env")  # the doctor
    assert "all is well" in said
    assert "FAIL" not in said
    for id in sumo_env.IDS:
        (line,) = [line for line in said.splitlines() if f" {sumo_env.task_of(id)} " in line]
        assert "steps/s" in line


def test_a_problem_is_told_and_ends_the_examination(monkeypatch: pytest.MonkeyPatch) -> None:
    def never() -> str:
        raise AssertionError("this check rests on the one before")

    monkeypatch.delitem(sys.modules, "sumo_env.sumo.engine", raising=False)
    monkeypatch.setitem(sys.modules, "libsumo", None)  # an import raises ImportError
    out = io.StringIO()
    checks = (("first", lambda: "fine"), ("SUMO", doctor.sumo), ("third", never))
    assert doctor.examine(checks, out) == 1
    said = out.getvalue()
    assert "ok    first" in said and "FAIL  SUMO" in said and "SUMO is missing" in said
    assert "pip install libsumo==" in said and "third" not in said


def test_a_system_that_cannot_load_sumo_is_told_what_it_lacks(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As in a slim container, where the wheel is installed and the libraries of the window are not."""
    (tmp_path / "libsumo.py").write_text("raise ImportError('libX11.so.6: cannot open shared object file')")
    monkeypatch.delitem(sys.modules, "sumo_env.sumo.engine", raising=False)
    monkeypatch.delitem(sys.modules, "libsumo", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ImportError, match=r"SUMO is here.*libx11-6.*libX11\.so\.6: cannot open"):
        doctor.sumo()


def test_episodes_that_differ_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    from sumo_env.env import DrivingEnv

    reset = DrivingEnv.reset
    seeds = iter(range(100))
    monkeypatch.setattr(DrivingEnv, "reset", lambda self, **kwargs: reset(self, seed=next(seeds)))
    with pytest.raises(RuntimeError, match="two different episodes"):
        doctor.task("sumo/u-turn-v0")
