"""Where tasks are computed: processes of this machine, a Ray cluster, or Slurm, all behind one standard interface."""

from __future__ import annotations

from concurrent.futures import Executor
from pathlib import Path

from experiments.study.attempt import Ended
from experiments.support.errors import unknown

EXECUTORS = ("local",)


def open_executor(name: str, workers: int, directory: Path, tasks_per_process: int) -> Executor:
    """An executor by name.

    Args:
        workers: how many tasks are computed at a time.
        directory: for what the executor itself writes.
        tasks_per_process: then a fresh process takes over, so that whatever a simulator leaks is given back.

    Raises:
        UserError: there is none of this name, or its package is not installed.
    """
    if name == "local":
        from experiments.study.executors.local import LocalExecutor

        return LocalExecutor(workers, tasks_per_process, _spoilt)
    raise unknown("executor", name, EXECUTORS)


def _spoilt(ended: Ended) -> bool:
    """After an error nobody knows in what state a simulator is: the next try gets a fresh process."""
    return ended.state in ("failed", "fatal")
