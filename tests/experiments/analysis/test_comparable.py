"""Which cells are compared: those of one setting."""

from __future__ import annotations

from typing import Any

from experiments.analysis.analysis import analyse
from experiments.analysis.cells import comparable
from experiments.study.grid import BASELINES
from experiments.study.store import load
from tests.experiments import synthetic


def test_the_last_sweep_decides(tmp_path: Any) -> None:
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, updates=200, baselines=())
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, updates=400)
    chosen, left_out = comparable(load(tmp_path))
    assert len(left_out) == 6
    assert all("updates 200 instead of 400" in reason for reason in left_out.values())
    learners = [cell["learner"] for cell in chosen.cells.values() if "learner" in cell]
    assert {learner["updates"] for learner in learners} == {400}
    assert set(chosen.episodes["cell"]) == set(chosen.cells)


def test_baselines_of_another_test_are_left_out(tmp_path: Any) -> None:
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=10, arms=())
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=20, baselines=())
    _, left_out = comparable(load(tmp_path))
    assert len(left_out) == len(BASELINES)
    assert all("episodes 10 instead of 20" in reason for reason in left_out.values())


def test_presets_are_labels(tmp_path: Any) -> None:
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, preset="quick")
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, preset="paper")
    found = analyse(load(tmp_path))
    assert found.notes["left_out"] == {} and found.effects["seeds_arm"].iloc[0] == 3
    assert found.provenance["presets"] == ["paper", "quick"]


def test_cells_that_fit_no_comparison_are_left_out_and_named(tmp_path: Any) -> None:
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, further=("dense",), updates=200)
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, updates=400)
    found, left_out = comparable(load(tmp_path))
    assert "dense" not in set(found.episodes["arm"])
    assert len(left_out) == 6
