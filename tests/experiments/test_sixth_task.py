"""A task of which nothing is published: it is studied where it is asked for alone, and what lacks a task says so."""

from pathlib import Path
from typing import Any

import pytest

from experiments import report
from experiments.study.design.arms import scenario_seed, training_seed
from experiments.study.design.cell import Cell
from experiments.study.design.presets import cells_of, of_preset
from experiments.study.design.sheet import GRID, SHEETS
from experiments.study.results.loaded import load
from experiments.sweep import Options, UserError, sweep
from sumo_env.tasks import TASKS
from tests.experiments.fake_env import make_env


def test_it_is_in_no_preset() -> None:
    assert "merge" in SHEETS and "merge" not in GRID
    assert {cell.task for cell in cells_of(of_preset(Options, "smoke"))} == set(GRID)


def test_a_backend_that_lacks_a_task_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(TASKS, "own", TASKS["u-turn"])  # on no backend
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


def test_a_variant_is_a_task_of_its_own_with_the_scenarios_of_its_task(
    tmp_path: Path, here: None, words_alone: None
) -> None:
    """From the cells to the report; simulators know nothing of it but its configuration."""
    made: list[tuple[str, Any]] = []

    def making(backend: str, task: str, config: Any = None, render_mode: str | None = None) -> Any:
        made.append((task, config["action"].get("target_speeds")))
        return make_env(backend, task, config, render_mode)

    asked = {"tasks": ("two-way-brakes", "two-way"), "seeds": 2, "updates": 40, "levels": (2,)}
    options = of_preset(Options, "smoke", out=tmp_path, workers=2, test_on=("replica",), **asked)
    both: list[list[Cell]] = [[], []]
    for cell in cells_of(options):
        both[cell.task == "two-way-brakes"].append(cell)
    for cell, variant in zip(*both, strict=True):
        assert variant.slug == cell.slug.replace("two-way", "two-way-brakes") and variant.name != cell.name
        for part in ("simulated", "dynamics", "profile"):
            assert getattr(variant, part) == getattr(cell, part)
        ours, theirs = (one.tested["env_config"] for one in (variant, cell))
        assert [key for key in theirs if ours[key] != theirs[key]] == ["action"]
        assert ours["action"]["target_speeds"] == [10, 20, 30]
    assert scenario_seed("two-way-brakes", 2, 7) == scenario_seed("two-way", 2, 7)
    assert training_seed("two-way-brakes", 2, 7) != training_seed("two-way", 2, 7)
    assert sweep(options, make_env=making, check=lambda _: None) == 0
    assert {(task, str(speeds)) for task, speeds in made} == {
        ("two-way", "None"),
        ("two-way", "[10, 20, 30]"),
    }
    analysis = report.analyse(load(tmp_path))
    assert [*dict.fromkeys(analysis.effects["task"])] == ["two-way", "two-way-brakes"]
    assert set(analysis.by_task["scope"]) == {"two-way", "two-way-brakes", "all tasks"}
    assert analysis.by_task.set_index("scope").loc["all tasks", "settings"].max() == 1  # those of the plan
    assert (analysis.effects.set_index("task").loc["two-way-brakes", "family"].fillna("") == "").all()
    assert "two-way-brakes 10+4" in (tmp_path / "appendix.html").read_text()
