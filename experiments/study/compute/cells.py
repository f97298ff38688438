"""Cells computed in processes: those that are not finished, each once."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from experiments import backends
from experiments.backends import MakeEnv
from experiments.study.compute.cell_task import CellTask
from experiments.study.compute.executors import cores, open_executor
from experiments.study.compute.executors.local import TASKS_PER_PROCESS
from experiments.study.compute.progress import ProgressDisplay, duration, seconds
from experiments.study.compute.run import run
from experiments.study.design.cell import Cell
from experiments.study.results.store import Store


def compute(
    cells: Sequence[Cell],
    directory: Path,
    make_env: MakeEnv = backends.make_env,
    executor: str = "local",
    workers: int | None = None,
) -> dict[str, str]:
    """Compute the cells that are not finished; returns the reason of each failure by the name of its cell.

    make_env: of `backends`, or another that is importable in other processes. executor, workers: see
    `executors.open_executor`.
    """
    store = Store(directory)
    tasks = {cell.name: CellTask(cell, directory, make_env) for cell in cells}
    there = {name for name, task in tasks.items() if task.done()}
    for name in there:  # where a kill left it
        shutil.rmtree(store.work / name, ignore_errors=True)
    sizes = {cell.name: seconds(cell) for cell in cells}
    print(f"{len(tasks)} cells, {len(there)} of them finished before; results go to {directory}", flush=True)
    if executor == "local" and (left := sum(size for name, size in sizes.items() if name not in there)):
        number = workers or cores()
        print(f"about {duration(left / number)} with {number} processes on a common server", flush=True)
    # highway-env's tasks change class attributes of each other
    simulators = {name for cell in cells for name, _ in cell.simulated}
    per_process = 1 if "highway-env" in simulators else TASKS_PER_PROCESS
    failures: dict[str, str] = {}
    with closing(ProgressDisplay(store.work, sizes, there)) as progress:
        for kinds in (("agent", "baseline"), ("test",)):  # agents are tested elsewhere once all are trained
            batch = [task for name, task in tasks.items() if name not in there and task.cell.kind in kinds]
            if kinds == ("test",):
                batch = [task for task in batch if store.weights(task.cell.parent.name)]
            if batch:
                opened = open_executor(executor, workers, directory, per_process, len(batch))
                failures |= run(batch, *opened, progress)
    return failures
