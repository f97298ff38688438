"""Whatever happens to the files of a sweep: a damaged one is named, never analysed, and its cell computed again."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

from experiments.study.run import attempt
from experiments.study.store import Store, load
from experiments.support.errors import UserError
from tests.experiments.computed import damage, fingerprint, tasks_of

pytestmark = pytest.mark.slow


class Cut(Exception):
    """Ends a training."""


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory) -> Path:
    """A directory with an agent in the middle of its training, as `kill -9` leaves it."""
    directory = tmp_path_factory.mktemp("interrupted")

    def cut(fraction: float) -> None:
        if (task.folder / "checkpoint.npz").exists():
            raise Cut

    task = next(task for task in tasks_of(directory) if task.cell.kind == "agent")
    task.folder.mkdir(parents=True)
    with pytest.raises(Cut):
        task.compute(cut)
    return directory


@pytest.mark.parametrize(
    ("name", "how"),
    [
        ("checkpoint.npz", "cut"),
        ("checkpoint.npz", "changed"),
        ("progress.json", "changed"),
        ("lock", "gone"),
        ("log.txt", "cut"),
        ("finished-x-1/cell.json", "empty"),
    ],
)
def test_a_damaged_working_file_costs_at_most_the_cell(finished, interrupted, tmp_path, name, how):
    directory = tmp_path / "results"
    shutil.copytree(interrupted, directory)
    task = next(task for task in tasks_of(directory) if task.cell.kind == "agent")
    path = task.folder / name
    path.parent.mkdir(exist_ok=True)
    if not path.exists():
        path.write_text("0.5")
    damage(path, how)
    Store(directory).failures()
    assert attempt(task).state == "done"
    assert fingerprint(directory)[task.name] == fingerprint(finished)[task.name]


class Payload:
    """Leaves a trace where it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self):
        return Path.touch, (self.trace,)


def test_nothing_is_unpickled_from_a_file(finished, interrupted, tmp_path):
    trace = tmp_path / "unpickled"
    bomb = np.array([Payload(trace)], dtype=object)
    for number, origin in enumerate((finished, interrupted)):
        directory = tmp_path / str(number)
        shutil.copytree(origin, directory)
        for path in [*directory.glob("cells/*/*"), *directory.glob("work/*/*"), directory / "sweep.json"]:
            if path.suffix == ".npz":
                with path.open("wb") as file:
                    np.savez(file, settings=bomb, weights=bomb)
            else:
                path.write_bytes(pickle.dumps(bomb))
        with pytest.raises(UserError):
            load(directory)
        assert {attempt(task).state for task in tasks_of(directory)} == {"done"}
    assert not trace.exists()
    np.load(min((directory / "damaged").iterdir()), allow_pickle=True)["settings"]
    assert trace.exists()  # the trap works
