"""Whatever happens to the files of a sweep: a damaged one is named, never analysed, and its cell computed again."""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from experiments.study import store
from experiments.study.run import attempt
from experiments.study.store import load
from experiments.support.errors import UserError
from tests.experiments.computed import fingerprint, tasks_of

pytestmark = pytest.mark.slow

PROPERTY = settings(
    max_examples=5,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)


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


@st.composite
def damages(draw):
    """A function from the content of a file to what is left of it; None if the file is gone."""
    position, byte = draw(st.floats(0, 1, exclude_max=True)), draw(st.integers(1, 255))
    garbage = draw(st.binary(max_size=100))

    def flip(content: bytes) -> bytes:
        at = int(position * len(content))
        return content[:at] + bytes([content[at] ^ byte]) + content[at + 1 :]

    cut = [
        lambda content: content[: int(position * len(content))],
        lambda content: garbage,
        lambda content: None,
    ]
    return draw(st.sampled_from([flip, *cut]))


def harm(path: Path, damage) -> bool:
    """Damage a file; False if its content has stayed the same."""
    before = path.read_bytes()
    after = damage(before)
    if after is None:
        path.unlink()
    else:
        path.write_bytes(after)
    return before != after


@PROPERTY
@given(
    name=st.sampled_from(["checkpoint.npz", "progress.json", "lock", "log.txt", "finished-x-1/cell.json"]),
    damage=damages(),
)
def test_a_damaged_working_file_costs_at_most_the_cell(finished, interrupted, tmp_path_factory, name, damage):
    directory = tmp_path_factory.mktemp("copy") / "results"
    shutil.copytree(interrupted, directory)
    task = next(task for task in tasks_of(directory) if task.cell.kind == "agent")
    path = task.folder / name
    path.parent.mkdir(exist_ok=True)
    if not path.exists():
        path.write_text("0.5")
    harm(path, damage)
    store.Store(directory).failures()
    ended = attempt(task)
    assert ended.state == "done", ended
    assert fingerprint(directory)[task.name] == fingerprint(finished)[task.name]
    shutil.rmtree(directory)


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
    np.load(
        directory / "damaged" / sorted(p.name for p in (directory / "damaged").iterdir())[0],
        allow_pickle=True,
    )["settings"]
    assert trace.exists()  # the trap works
