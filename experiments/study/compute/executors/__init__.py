"""Where tasks are computed: processes of this machine, a Ray cluster, or Slurm, all behind one standard interface."""

import os
from concurrent.futures import Executor
from pathlib import Path

from experiments.support.errors import UserError

EXECUTORS = ("local", "ray", "slurm")
SLURM_JOBS = 100  # at a time, unless the user says otherwise


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def open_executor(
    name: str, workers: int | None, directory: Path, tasks_per_process: int, tasks: int
) -> tuple[Executor, int]:
    """An executor by name, and how many tasks it should be given at a time.

    Args:
        workers: that number; by default the cores of the machine or of the cluster.
        directory: for what the executor itself writes.
        tasks_per_process: then a fresh process takes over, so that whatever a simulator leaks is given back.
        tasks: how many there are; this machine starts no more processes.

    Raises:
        UserError: its package is not installed, or it cannot be reached.
    """
    try:
        if name == "ray":
            from experiments.study.compute.executors.ray import RayExecutor

            cluster = RayExecutor(workers, tasks_per_process)
            return cluster, workers or cluster.workers
        if name == "slurm":
            from experiments.study.compute.executors.slurm import SlurmExecutor

            return SlurmExecutor(directory / "slurm"), workers or SLURM_JOBS
    except ModuleNotFoundError as error:
        raise UserError(
            f"--executor {name} needs the package {error.name}: .venv/bin/python -m pip install '.[{name}]'"
        ) from None
    from experiments.study.compute.executors.local import LocalExecutor

    number = min(workers or cores(), tasks)
    return LocalExecutor(number, tasks_per_process), number
