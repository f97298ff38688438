"""Cells on disk: whole or absent, checked when read, loaded as tidy tables."""

from __future__ import annotations

import contextlib
import json
import shutil
import threading
from dataclasses import replace

import pandas as pd
import pytest
from torch import nn

from agents.greedy import Greedy
from experiments.study import grid, store
from experiments.study.evaluate import evaluate
from experiments.study.experiment import Experiment
from experiments.study.store import KEY_COLUMNS, load
from experiments.support.errors import UserError
from sumo_env.tasks import TASKS
from tests.experiments.fake_env import make_env


class Idle:
    def act(self, observation):
        return 1

    def reset(self, seed):
        pass


TRAINING_TABLE = pd.DataFrame(
    {
        "episode": [0],
        "step": [3],
        "return": [1.0],
        "length": [3],
        "crashed": [True],
        "arrived": [False],
        "mean_speed": [20.0],
        "epsilon": [1.0],
    }
)


@pytest.fixture(scope="module")
def cells() -> list[grid.Cell]:
    learners = {task: {"updates": 10, "gamma": 0.95} for task in TASKS}
    tasks = ("highway", "u-turn")
    return Experiment(tasks=tasks, levels=(1,), seeds=1, episodes=3, learners=learners).cells()


@pytest.fixture(scope="module")
def finished(tmp_path_factory, cells):
    """A directory with all cells finished."""
    folder = tmp_path_factory.mktemp("finished")
    home = store.Store(folder / "results")
    weights = folder / "weights.npz"
    Greedy(nn.Linear(10, 5)).save(weights)
    for cell in cells:
        env = make_env(cell.backend, cell.task, cell.env_config)
        table = evaluate(env, Idle(), cell.task, cell.level, cell.episodes)
        files = {store.EPISODES: table, store.GATES: table}
        record = {"timing": {"test_seconds": 1.0}, "provenance": {"cpu": "none"}}
        if cell.kind == "agent":
            files |= {store.TRAINING: TRAINING_TABLE, store.WEIGHTS: weights}
            record["learner"] = {
                "updates": 10,
                "episodes": 1,
                "probe_q": [[5, 0.1, 0.2], [10, 0.3, 0.5]],
                "q_bound": 20.0,
                "weights_sha256": "x",
            }
        home.write(cell, record, files)
    return home.directory


@pytest.fixture
def directory(finished, tmp_path):
    """A copy of it."""
    return shutil.copytree(finished, tmp_path / "results")


def test_a_stored_cell_is_finished_and_comes_back(directory, cells):
    home = store.Store(directory)
    assert home.finished() == sorted(cell.name for cell in cells)
    with pytest.raises(KeyError):
        home.record(replace(cells[0], seed=77).name)
    record = store.read_cell(directory / "cells" / cells[0].name)
    assert record["key"] == json.loads(json.dumps(cells[0].key()))
    assert set(record["files"]) == {store.EPISODES, store.GATES, store.TRAINING, store.WEIGHTS}


def test_results_are_tidy(directory, cells):
    results = load(directory)
    assert len(cells) == len(results.cells)
    assert len(results.episodes) == len(cells) * 2 * 3
    assert set(KEY_COLUMNS) <= set(results.episodes.columns) & set(results.gate_episodes.columns)
    agents = results.episodes[results.episodes.kind == "agent"]
    assert set(agents.seed) == {0}
    assert results.episodes[results.episodes.kind == "baseline"].seed.isna().all()
    counts = results.episodes.groupby(["cell", "traffic"]).size()
    assert (counts == 3).all()
    home = store.Store(directory)
    trained = {cell for cell in results.cells if store.TRAINING in home.tables(cell)}
    assert trained == set(agents.cell)


def test_writing_twice_keeps_the_first(directory, cells):
    home = store.Store(directory)
    path = directory / "cells" / cells[-1].name
    before = (path / store.CELL).read_bytes()
    home.write(cells[-1], {"timing": "other"}, {store.EPISODES: TRAINING_TABLE})
    assert (path / store.CELL).read_bytes() == before
    assert not list(home.work.glob("*/*"))


@pytest.mark.parametrize("file", [store.CELL, store.EPISODES, store.TRAINING, store.WEIGHTS])
@pytest.mark.parametrize("damage", ["cut", "gone", "changed", "empty"])
def test_damage_is_told_in_one_line_that_names_file_and_remedy(directory, cells, file, damage):
    path = directory / "cells" / cells[0].name / file
    content = path.read_bytes()
    if damage == "gone":
        path.unlink()
    elif damage == "changed":
        path.write_bytes(content.replace(content[-30:-20], b"0123456789"))
    else:
        path.write_bytes(content[: len(content) // 2] if damage == "cut" else b"")
    for read in (lambda: store.Store(directory).record(cells[0].name), lambda: load(directory)):
        with pytest.raises(store.DamagedCell) as error:
            read()
        message = str(error.value)
        assert "\n" not in message
        assert str(path.parent) in message
        assert "run the sweep again" in message


def test_a_cell_under_a_wrong_name_is_noticed(directory, cells):
    path = directory / "cells" / cells[0].name
    shutil.move(path, path.with_name("sumo-highway-50-control-s9-0123456789ab"))
    with pytest.raises(store.DamagedCell, match="content"):
        load(directory)


def test_a_damaged_note_does_not_ask_for_the_results_to_be_deleted(directory):
    (directory / "sweep.json").write_text("{")
    with pytest.raises(UserError, match="delete this file"):
        load(directory)


def test_sweeps_add_up_but_for_what_was_never_finished_and_is_not_asked_for_again(tmp_path, cells):
    home = store.Store(tmp_path)
    first, _, third, *rest = (cell for cell in cells if cell.task == "u-turn")
    highway = [cell for cell in cells if cell.task == "highway"]
    (home.cells / first.name).mkdir(parents=True)
    home.write_sweep("all", cells)
    home.write_sweep("third", [third])
    home.write_sweep("rest", rest)
    assert store.Store(tmp_path).sweeps() == [
        {"command": "all", "cells": [cell.name for cell in (*highway, first)]},
        {"command": "rest", "cells": [cell.name for cell in rest]},
    ]
    home.write_sweep("all again", cells)
    assert store.Store(tmp_path).sweeps() == [
        {"command": "all again", "cells": [cell.name for cell in cells]}
    ]


def test_sweeps_that_start_at_once_lose_no_note(tmp_path, cells, monkeypatch):
    read, both = store.Store.sweeps, threading.Barrier(2)

    def slowly(home):
        found = read(home)
        with contextlib.suppress(threading.BrokenBarrierError):
            both.wait(0.5)  # for the other, which must not be here
        return found

    monkeypatch.setattr(store.Store, "sweeps", slowly)
    home = store.Store(tmp_path)
    halves = [[cell for cell in cells if cell.task == task] for task in ("highway", "u-turn")]
    threads = [threading.Thread(target=home.write_sweep, args=(half[0].task, half)) for half in halves]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {sweep["command"] for sweep in read(home)} == {"highway", "u-turn"}


def test_results_know_all_cells_that_sweeps_asked_for(directory, cells):
    home = store.Store(directory)
    home.write_sweep("most", cells[1:])
    home.write_sweep("one", cells[:1])
    assert load(directory).expected == tuple(cell.name for cell in (*cells[1:], cells[0]))


def test_a_directory_without_results_is_told_from_an_empty_one(tmp_path):
    with pytest.raises(UserError, match="no results"):
        load(tmp_path / "nowhere")
    store.Store(tmp_path / "new").write_sweep("none", [])
    with pytest.raises(UserError, match="no finished cell"):
        load(tmp_path / "new")


def test_damaged_cells_are_passed_over_and_named_on_request(directory, cells):
    (directory / "cells" / cells[0].name / store.EPISODES).write_bytes(b"")
    results = load(directory, skip_damaged=True)
    assert list(results.damaged) == [cells[0].name]
    assert "run the sweep again" in results.damaged[cells[0].name]
    assert cells[0].name not in results.cells
    assert set(results.episodes["cell"]) == set(results.cells)


def test_a_further_test_has_test_episodes_alone(directory, cells):
    agent = next(cell for cell in cells if cell.kind == "agent")
    doses = {"backend": "sumo", "traffics": ["dose50"], "episodes": 3, "env_config": agent.env_config}
    test = replace(agent, kind="test", test_on=doses)
    env = make_env(test.backend, test.task, test.env_config)
    table = evaluate(env, Idle(), test.task, test.level, 3, traffics=("dose50",))
    store.Store(directory).write(test, {}, {store.EPISODES: table})
    found = load(directory)
    assert found.cells[test.name]["key"]["test_on"]["traffics"] == ["dose50"]
    assert (found.episodes["cell"] == test.name).sum() == 3
    assert test.name not in set(found.gate_episodes["cell"])
