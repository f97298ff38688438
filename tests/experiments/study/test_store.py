"""Cells on disk: whole or absent, checked when read, loaded as tidy tables."""

import contextlib
import pickle
import shutil
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.report import write_report
from experiments.study.compute.run import attempt
from experiments.study.design.cell import Cell
from experiments.study.results import store
from experiments.study.results.loaded import load
from experiments.study.results.schema import EPISODES, WEIGHTS
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from tests.experiments import synthetic
from tests.experiments.computed import compute, damage, tasks_of


@pytest.fixture(scope="module")
def cells(finished) -> list[Cell]:
    return [task.cell for task in tasks_of(finished)]


def test_cells_that_were_tested_on_another_simulator_are_read_without_the_others(tmp_path):
    written = synthetic.write(tmp_path, {"u-turn": (1,)}, tests=4, seeds=1, test_on=("replica",))
    for cell in written:
        if cell.test_on is None:
            (tmp_path / "cells" / f"{cell.name}.parquet").unlink()
    results = load(tmp_path)
    assert len(results.episodes) > 0 and results.gate_episodes.empty
    with pytest.raises(UserError, match="nothing to report"):
        write_report(tmp_path)


def test_a_further_test_of_an_agent_that_was_trained_again_is_computed_again(tmp_path, monkeypatch):
    tasks = {task.cell.kind: task for task in tasks_of(tmp_path, arms=("control",), traffics=("dose25",))}
    compute(tasks[kind] for kind in ("agent", "test"))
    record, agent, test = Store.record, tasks["agent"].name, tasks["test"]
    assert test.done()

    def trained_again(store, name):
        found = record(store, name)
        return {**found, "files": {**found["files"], WEIGHTS: "another"}} if name == agent else found

    monkeypatch.setattr(Store, "record", trained_again)
    assert not test.done() and len(list((tmp_path / "damaged").iterdir())) == 1


def test_writing_twice_keeps_the_first(results, cells):
    home = store.Store(results)
    path = results / "cells" / f"{cells[-1].name}.parquet"
    before = path.read_bytes()
    tables = home.tables(cells[-1].name)
    other = tables[EPISODES].assign(distance=0.0)
    home.write(cells[-1], {"timing": {}}, {**tables, EPISODES: other})
    assert path.read_bytes() == before
    assert not list(home.work.glob("*/*"))


@pytest.mark.parametrize(
    "change",
    [
        lambda cell, files: (replace(cell, eval={**cell.eval, "episodes": 4}), files),
        lambda cell, files: (cell, {**files, EPISODES: files[EPISODES].assign(distance=np.nan)}),
        lambda cell, files: (cell, {**files, EPISODES: files[EPISODES].drop(columns="return")}),
    ],
)
def test_what_a_reader_would_refuse_is_not_stored(finished, tmp_path, cells, change):
    """Else a cell could be computed, found to be damaged and computed again without an end."""
    home, name = store.Store(finished), cells[0].name
    record, tables = home.record(name), home.tables(name)
    cell, files = change(cells[0], {**tables, store.WEIGHTS: home.weights(name)})
    with pytest.raises(ValueError):
        store.Store(tmp_path).write(cell, {part: record[part] for part in ("timing", "learner")}, files)
    assert not list(tmp_path.glob("cells/*"))


PLACES = ("cells/{}.parquet", "training/{}.parquet", "weights/{}.npz")
DAMAGES = [(place, how) for place in PLACES for how in ("cut", "gone", "changed", "empty")]
DAMAGES.remove((PLACES[0], "changed"))  # of some bytes of this file nothing depends: test_flips.py


@pytest.mark.parametrize(("place", "how"), DAMAGES)
def test_damage_is_told_in_one_line_that_names_file_and_remedy(results, cells, place, how):
    name = cells[0].name
    damage(path := results / place.format(name), how)
    if (place[:5], how) == ("cells", "gone"):
        assert not store.Store(results).is_whole(name)
        return
    with pytest.raises(store.DamagedCell) as error:
        store.Store(results).is_whole(name)
    message = str(error.value)
    assert "\n" not in message
    assert str(path if how != "gone" else results / "cells" / name) in message
    assert "run the sweep again" in message
    if place.startswith("cells"):
        found = load(results)
        assert found.damaged == {name: message}
        assert set(found.episodes["cell"]) == set(found.cells) == {cell.name for cell in cells[1:]}


def test_a_cell_under_a_wrong_name_is_noticed(results, cells):
    path = results / "cells" / f"{cells[0].name}.parquet"
    other = path.with_stem("sumo-highway-50-control-s9-0123456789ab")
    shutil.move(path, other)
    assert f"its content is that of {path.stem}" in load(results).damaged[other.stem]


def test_a_damaged_note_does_not_ask_for_the_results_to_be_deleted(results):
    (results / "sweep.json").write_text("{")
    with pytest.raises(UserError, match="delete this file"):
        load(results)


def test_sweeps_add_up_but_for_what_was_never_finished_and_is_not_asked_for_again(finished, tmp_path, cells):
    home = store.Store(tmp_path)
    first, _, third, *rest = cells
    highway = [task.cell for task in tasks_of(tmp_path, tasks=("highway",))]
    shutil.copytree(finished / "cells", home.cells)
    for cell in cells:
        if cell != first:
            (home.cells / f"{cell.name}.parquet").unlink()
    home.write_sweep("all", [*highway, *cells])
    home.write_sweep("third", [third])
    home.write_sweep("rest", rest)
    assert store.Store(tmp_path).sweeps() == [
        {"command": "all", "cells": [cell.name for cell in (*highway, first)]},
        {"command": "rest", "cells": [cell.name for cell in rest]},
    ]
    home.write_sweep("all again", [*highway, *cells])
    assert store.Store(tmp_path).sweeps() == [
        {"command": "all again", "cells": [cell.name for cell in (*highway, *cells)]}
    ]


def test_sweeps_that_start_at_once_lose_no_note(tmp_path, monkeypatch):
    read, both = store.Store.sweeps, threading.Barrier(2)

    def slowly(home):
        found = read(home)
        with contextlib.suppress(threading.BrokenBarrierError):
            both.wait(0.5)  # for the other, which must not be here
        return found

    monkeypatch.setattr(store.Store, "sweeps", slowly)
    home = store.Store(tmp_path)
    halves = [[task.cell for task in tasks_of(tmp_path, tasks=(one,))] for one in ("highway", "u-turn")]
    threads = [threading.Thread(target=home.write_sweep, args=(half[0].task, half)) for half in halves]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {sweep["command"] for sweep in read(home)} == {"highway", "u-turn"}


# -- whatever happens to the files, a damaged one is named, never analysed, and its cell computed again ------------


class Payload:
    """Leaves a trace where it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


@pytest.mark.slow
def test_nothing_is_unpickled_from_a_file(results, tmp_path):
    trace = tmp_path / "unpickled"
    bomb = np.array([Payload(trace)], dtype=object)
    for path in [*results.glob("*/*.*"), results / "sweep.json"]:
        if path.suffix == ".npz":
            with path.open("wb") as file:
                np.savez(file, settings=bomb, weights=bomb)
        else:
            path.write_bytes(pickle.dumps(bomb))
    with pytest.raises(UserError):
        load(results)
    assert {attempt(task).state for task in tasks_of(results)} == {"done"}
    assert not trace.exists()
    np.load(next(results.glob("damaged/*/*.npz")), allow_pickle=True)["settings"]
    assert trace.exists()  # the trap works
