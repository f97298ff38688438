"""What can be had in a setting: the command, and the marks that returns are scored by."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from experiments import attainable
from experiments.study.compute.foresight import batch_of_one, search
from experiments.study.design import attainable as design
from experiments.study.design.arms import scenario_seed
from experiments.study.design.levels import env_config
from experiments.support.files import read_json, write_json


@pytest.fixture(autouse=True)
def stored(here: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """In place of results/attainable.json."""
    monkeypatch.setattr(design, "FILE", tmp_path / "attainable.json")
    design.stored.cache_clear()
    yield tmp_path / "attainable.json"
    design.stored.cache_clear()


def ask(out: Path, **options: Any) -> dict[str, Any]:
    """What the command has found, by place."""
    assert attainable.run(attainable.Options(out=out, **options), ["--out", "there"]) == 0
    return dict(read_json(out / "found.json")["places"])


def test_searches_are_done_once_and_what_cannot_be_driven_is_named(
    tmp_path: Path, stored: Path, capsys
) -> None:
    asked: dict[str, Any] = {
        "tasks": ("two-way", "two-way-brakes"),
        "levels": (3,),
        "scenarios": 3,
        "width": 32,
    }
    found = ask(tmp_path, **asked, update=True)
    assert capsys.readouterr().out.splitlines()[-2].endswith("most scenarios: two-way 15+6")
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "episodes").iterdir()}
    assert ask(tmp_path, **asked) == found == read_json(stored)
    assert files == {path: path.stat().st_mtime_ns for path in (tmp_path / "episodes").iterdir()}
    assert set(found) == {
        f"{task} 15+6 {traffic}" for task in asked["tasks"] for traffic in ("regular", "risky")
    }
    assert design.undrivable(found) == ["two-way 15+6"]
    envs = batch_of_one("two-way", env_config("replica", "two-way-brakes", 3))
    each = [search(envs, scenario_seed("two-way", 3, k, "attainable"), 1.0, 32) for k in range(3)]
    own = found["two-way-brakes 15+6 risky"]["search"]
    assert own["return"] == pytest.approx(sum(one.best.value for one in each) / 3, rel=1e-6)
    assert own["no_safe"] == pytest.approx(sum(one.safe is None for one in each) / 3)
    others = ask(tmp_path, tasks=("two-way",), levels=(1,), scenarios=2, width=2, update=True)
    assert read_json(stored) == {**found, **others}


@pytest.mark.slow
def test_drivers_without_foresight_are_the_marks_of_returns(
    tmp_path: Path, stored: Path, monkeypatch
) -> None:
    monkeypatch.setattr(attainable, "MOST", {"planner": 1})
    asked: dict[str, Any] = {"backend": "sumo", "tasks": ("u-turn",), "levels": (1,)}
    found = ask(tmp_path, **asked, policies=("control",), scenarios=2, update=True)
    assert read_json(stored) == found
    sizes = {one.who: one.size for one in attainable.batches(attainable.Options(out=tmp_path, **asked))[0]}
    assert sizes["planner"] > sizes["idm"]  # by which the time that is left is estimated
    for place, of in found.items():
        kinds = {name: one["kind"] for name, one in of["drivers"].items()}
        assert {name for name, kind in kinds.items() if kind == "constant"} == {
            "IDLE", "FASTER", "SLOWER", "LANE_LEFT", "LANE_RIGHT",
        }  # fmt: skip
        assert (
            kinds["sumo"] == "more actions"
            and kinds["planner"] == kinds["careful-4"] == kinds["u-turn-3/control"] == "policy"
        )
        assert of["drivers"]["planner"]["scenarios"] == 1 and of["drivers"]["idm"]["scenarios"] == 2
        values = {
            kind: max(one["return"] for one in of["drivers"].values() if one["kind"] == kind)
            for kind in ("constant", "policy")
        }
        low, high = design.marks(*place.split(" "))
        assert (low, high) == (values["constant"], values["policy"]) or values["policy"] <= values["constant"]


def test_a_score_is_the_way_from_a_constant_action_to_the_best_policy(stored: Path) -> None:
    def driver(kind: str, value: float) -> dict[str, Any]:
        return {"kind": kind, "return": value}

    drivers = {
        "IDLE": driver("constant", 1.0),
        "SLOWER": driver("constant", 2.0),
        "careful": driver("policy", 5.0),
        "planner": driver("policy", 6.0),
        "sumo": driver("more actions", 9.0),
    }
    write_json(stored, {
        "u-turn 3 regular": {"drivers": drivers},
        "u-turn 3 risky": {"drivers": {**drivers, "IDLE": driver("constant", 6.0)}},
        "u-turn 6 regular": {"search": {"no_safe": 0.0}},
    })  # fmt: skip
    places = ["u-turn 3 regular", "u-turn 3 risky", "u-turn 6 regular", "merge 1 risky"]
    rows = [(*place.split(" "), value) for place in places for value in (6.0, 0.0)]
    scores = design.scores(pd.DataFrame(rows, columns=["task", "level_name", "traffic", "return"]))
    assert scores.tolist()[:2] == [1.0, -0.5]
    assert scores[2:].isna().all()  # where no policy beats a constant action, and where nothing is stored
