"""A task of which nothing is published: it is studied where it is asked for alone, and what lacks a task says so."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiments import report
from experiments.study.design.presets import cells_of, of_preset
from experiments.study.design.sheet import GRID, SHEETS
from experiments.study.results.loaded import load
from experiments.sweep import Options, UserError, sweep
from sumo_env.tasks import TASKS
from sumo_env.tasks.u_turn import UTurn
from tests.experiments.fake_env import make_env


class Own(UTurn):
    """A task that is on no backend."""

    name = "own"


def test_it_is_in_no_preset() -> None:
    assert "merge" in SHEETS and "merge" not in GRID
    assert {cell.task for cell in cells_of(of_preset(Options, "smoke"))} == set(GRID)


def test_a_backend_that_lacks_a_task_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TASKS, "own", Own())
    with pytest.raises(UserError, match="add its sheet"):
        cells_of(of_preset(Options, tasks=("own",)))
    monkeypatch.setitem(SHEETS, "own", SHEETS["u-turn"])
    for name in ("replica", "highway-env"):
        with pytest.raises(UserError, match=f"the backend {name} has no task own"):
            cells_of(of_preset(Options, tasks=("own",), backend=name))


def test_it_is_studied_and_decides_nothing(tmp_path: Path, here: None, words_alone: None) -> None:
    options = of_preset(Options, "smoke", out=tmp_path, tasks=("merge",), seeds=2, updates=40, workers=2)
    assert sweep(options, make_env=make_env, check=lambda _: None) == 0
    analysis = report.analyse(load(tmp_path))
    assert set(analysis.effects["task"]) == {"merge"}
    assert set(analysis.claims["verdict"]) <= {"not decided"}  # no claim of the plan is on the merge
    assert set(analysis.effects["family"].fillna("")) == {""}
    assert "merge" in (tmp_path / "appendix.html").read_text()
    assert "asks nothing about merge" in report.answer(tmp_path)
