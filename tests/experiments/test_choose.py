"""The rule by which a learner is chosen, on sweeps of the fake environment."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments import choose
from experiments.study.design.cell import setting_of_agent
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from tests.experiments.computed import sweep_of, tasks_of

CANDIDATES: dict[str, dict[str, Any]] = {
    "one": {"updates": 40},
    "three": {"updates": 60, "settings": ("n_steps=3",)},
}


def returns(folder: Path) -> dict[tuple[str, str], float]:
    """Mean returns by who drives and traffic."""
    store, found = Store(folder), dict[tuple[str, str], float]()
    for name in store.finished():
        key, episodes = store.record(name)["key"], store.tables(name)[EPISODES]
        for traffic, own in episodes.groupby("traffic"):
            found[f"{key['arm'] or key['policy']}-{key['seed']}", str(traffic)] = own["return"].mean()
    return found


def test_agents_are_scored_between_the_best_constant_action_and_the_best_driver_of_all(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    for name, options in CANDIDATES.items():
        sweep_of(tmp_path / name / "fake", seeds=2, **options)
    folders = tuple(tmp_path / name for name in CANDIDATES)
    stored = tmp_path / "table.csv"
    assert choose.main(choose.Options(folders, stored)) == 0
    table = choose.chosen(choose.scored(pd.concat(map(choose.drivers, folders), ignore_index=True)))
    found = {folder.name: returns(folder / "fake") for folder in folders}
    scores: dict[str, list[float]] = {name: [] for name in found}
    for arm, traffic in (("control", "regular"), ("treatment", "risky")):
        there = [value for own in found.values() for (_, where), value in own.items() if where == traffic]
        low = max(found["one"][f"{policy}-None", traffic] for policy in ("idle", "faster", "slower"))
        for name, own in found.items():
            agents = np.array([own[f"{arm}-{seed}", traffic] for seed in (0, 1)])
            scores[name] += ((agents - low) / (max(there) - low)).tolist()
    assert table["score"].to_dict() == pytest.approx({name: np.mean(own) for name, own in scores.items()})
    assert table["score"].is_monotonic_decreasing and (table["cpu"] > 0.0).all()
    printed = capsys.readouterr().out
    assert table.index[0] in printed.splitlines()[-2]

    for name in Store(folders[1] / "fake").finished():
        if not setting_of_agent(name):  # rules may drive in one folder alone
            (folders[1] / "fake" / "cells" / f"{name}.parquet").unlink()
    again = choose.chosen(choose.scored(pd.concat(map(choose.drivers, folders), ignore_index=True)))
    assert again["score"].to_dict() == table["score"].to_dict()

    assert choose.main(choose.Options(table=stored)) == 0  # without the folders
    assert capsys.readouterr().out == printed


def test_where_a_constant_action_is_best_nothing_is_scored() -> None:
    place = {
        "sweep": "fake",
        "backend": "sumo",
        "task": "u-turn",
        "level": 1,
        "level_name": "3",
        "traffic": "regular",
    }
    agent = {"policy": "dqn", "arm": "control", "seed": 0, "return": 4.0}
    rows = [{**agent, "candidate": name, **place} for name in ("one", "two")]
    idle = {"policy": "idle", "arm": None, "seed": None, "return": 5.0, "candidate": "one", **place}
    with pytest.raises(UserError, match="constant action is the best driver of u-turn 3"):
        choose.scored(pd.DataFrame([*rows, idle]))


def test_candidates_need_the_same_agents_and_all_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture
) -> None:
    for name, seeds in (("one", 1), ("two", 2)):
        sweep_of(tmp_path / name / "fake", seeds=seeds)
    with pytest.raises(UserError, match="have not the same agents"):
        choose.main(choose.Options((tmp_path / "one", tmp_path / "two")))
    folder = tmp_path / "two" / "fake"
    Store(folder).write_sweep("more", [task.cell for task in tasks_of(folder, seeds=3)])
    assert choose.drivers(tmp_path / "two").empty and "has not all its agents" in capsys.readouterr().out
    (tmp_path / "none").mkdir()
    with pytest.raises(UserError, match="no folder of a sweep"):
        choose.main(choose.Options((tmp_path / "none",)))
