"""Sweeps of the fake environment that are computed in this process, cell by cell."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from experiments.study.compute.cells import CellTask
from experiments.study.compute.run import Attempt, attempt
from experiments.study.design.presets import cells_of, of_preset
from experiments.study.results.store import Store
from experiments.sweep import Options
from tests.experiments.fake_env import make_env

TINY: dict[str, Any] = {
    "preset": "smoke",
    "tasks": ("u-turn",),
    "updates": 40,
    "network": "dueling",
    "episodes": 3,
}


def tasks_of(directory: Path, **options: Any) -> list[CellTask]:
    """The cells of a sweep that is tiny but for these options."""
    return [
        CellTask(cell, directory, make_env)
        for cell in cells_of(of_preset(Options, out=directory, **{**TINY, **options}))
    ]


def compute(tasks: Iterable[CellTask]) -> None:
    for task in tasks:
        assert attempt(task) == Attempt("done")


def sweep_of(directory: Path, **options: Any) -> None:
    """Compute the cells of a sweep, with its note."""
    tasks = tasks_of(directory, **options)
    Store(directory).write_sweep("sweep", [task.cell for task in tasks])
    compute(tasks)


def damage(path: Path, how: str) -> None:
    """Leave of a file its first half ("cut"), nothing in it ("empty"), no file ("gone"), or change one byte."""
    content, half = path.read_bytes(), path.stat().st_size // 2
    changed = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
    path.unlink()
    if how != "gone":
        path.write_bytes({"cut": content[:half], "empty": b"", "changed": changed}[how])


def fingerprint(directory: Path) -> dict[str, dict[str, str]]:
    """Checksums of all results, by cell: two sweeps that computed the same have the same."""
    return {name: record["files"] for name, record in Store(directory).records().items()}
