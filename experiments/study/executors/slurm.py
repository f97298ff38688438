"""Slurm, by submitit: every task is a job, those that are handed over together are a job array.

What a site asks for is set with sbatch's own variables (SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_TIMELIMIT,
SBATCH_MEM_PER_NODE), which take precedence over what is set here.
"""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import submitit
from submitit.helpers import DelayedSubmission

from experiments.support.errors import UserError

ROOT = Path(__file__).resolve().parents[3]
POLL = 1.0  # [s] between two looks at the jobs; submitit itself asks Slurm less and less often
TIME, MEMORY = 4 * 60, 2.0  # of a job [min], [GB]
REQUEUES = 20  # a job that runs into its time limit, or is preempted, goes on from its checkpoint so often


class SlurmExecutor(Executor):
    """Jobs of one core each. The nodes must see the checkout and the result directory under the same paths.

    Args:
        folder: for submitit's scripts, logs and messages between the processes.
        cluster: "slurm", or "local" for submitit's processes on this machine, which tests use.
    """

    def __init__(self, folder: Path, cluster: str = "slurm") -> None:
        # Jobs inherit the environment.
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
        try:
            self._jobs = submitit.AutoExecutor(folder=folder, cluster=cluster, slurm_max_num_timeout=REQUEUES)
        except RuntimeError as error:
            raise UserError(f"{error}: --executor slurm is for machines that submit jobs to Slurm") from None
        if cluster == "slurm" and subprocess.run(["sacct"], capture_output=True, check=False).returncode:
            raise UserError(
                "sacct fails, which tells submitit what jobs have died: use --shard in a job array instead"
            )
        self._jobs.update_parameters(
            name="sweep", timeout_min=TIME, mem_gb=MEMORY, cpus_per_task=1, stderr_to_stdout=True
        )
        self._new: list[tuple[Future[Any], Callable[..., Any], tuple[Any, ...], dict[str, Any]]] = []
        self._open: dict[Future[Any], submitit.Job[Any]] = {}
        self._lock = threading.Lock()
        self._closed = threading.Event()
        threading.Thread(target=self._follow, name="follow jobs", daemon=True).start()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a job."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()  # from now on it cannot be cancelled alone
        with self._lock:
            self._new.append((future, function, args, kwargs))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more; with `cancel_futures`, cancel the jobs."""
        self._closed.set()
        with self._lock:
            jobs = list(self._open.values())
        if cancel_futures and jobs:
            with ThreadPoolExecutor(16) as pool:  # every job takes a call of scancel
                list(pool.map(lambda job: job.cancel(check=False), jobs))
        elif wait:
            for job in jobs:
                job.wait()

    def _follow(self) -> None:
        """Hand over new jobs and take in the results, in a thread."""
        while not self._closed.wait(POLL):
            with self._lock:
                new, self._new = self._new, []
                if new:
                    self._hand_over(new)
            for future, job in list(self._open.items()):
                if job.done():
                    del self._open[future]
                    _take(job, future)

    def _hand_over(self, new: list[Any]) -> None:
        try:
            with self._jobs.batch():
                jobs = [
                    self._jobs.submit(Restartable(), call, *args, **kwargs) for _, call, args, kwargs in new
                ]
        except Exception as error:  # sbatch refuses: no such partition, no account, too many jobs
            for future, *_ in new:
                future.set_exception(UserError(f"Slurm takes no job: {error}".replace("\n", " ")))
            return
        self._open.update((entry[0], job) for entry, job in zip(new, jobs, strict=True))


def _take(job: submitit.Job[Any], future: Future[Any]) -> None:
    try:
        future.set_result(job.result())
    except (
        Exception
    ):  # submitit's own words name its files and show the end of the log, which is there to be read
        future.set_exception(JobFailed(f"its job {job.job_id} is {job.state} (output: {job.paths.stdout})"))


class JobFailed(RuntimeError):
    """A job ended without a result."""


class Restartable:
    """A call that goes on from its own checkpoint when Slurm ends the job and submitit hands it in again."""

    def __call__(self, function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Call the function."""
        return function(*args, **kwargs)

    def checkpoint(self, *args: Any, **kwargs: Any) -> DelayedSubmission:
        """What is to be called in the next job."""
        return DelayedSubmission(self, *args, **kwargs)
