"""Slurm, by submitit: every task is a job.

What a site asks for is set with sbatch's own variables (SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_TIMELIMIT,
SBATCH_MEM_PER_NODE), which take precedence over what is set here.
"""

import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, NoReturn

import submitit

from experiments.study.compute.progress import duration
from experiments.support.errors import UserError

ROOT = Path(__file__).resolve().parents[4]
POLL = 1.0  # [s] between two looks at the jobs; submitit itself asks Slurm less and less often
TIME, MEMORY = 4 * 60, 2.0  # of a job [min], [GB]


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
            self._jobs = submitit.AutoExecutor(folder=folder, cluster=cluster)
        except RuntimeError as error:
            raise UserError(f"{error}: --executor slurm is for machines that submit jobs to Slurm") from None
        if cluster == "slurm" and subprocess.run(["sacct"], capture_output=True, check=False).returncode:
            raise UserError(
                "sacct fails, which tells submitit what jobs have died: use --shard in a job array instead"
            )
        self._jobs.update_parameters(
            name="sweep", timeout_min=TIME, mem_gb=MEMORY, cpus_per_task=1, stderr_to_stdout=True
        )
        self._running: dict[Future[Any], submitit.Job[Any]] = {}
        self._closed = threading.Event()
        self._follower = threading.Thread(target=self._follow, name="follow jobs", daemon=True)
        self._follower.start()

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a job."""
        future: Future[Any] = Future()
        future.set_running_or_notify_cancel()  # from now on it cannot be cancelled alone
        try:
            self._running[future] = self._jobs.submit(within_limit, function, *args, **kwargs)
        except Exception as error:  # sbatch refuses: no such partition, no account, too many jobs
            future.set_exception(UserError(f"Slurm takes no job: {error}".replace("\n", " ")))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more, when all jobs are done; with `cancel_futures`, cancel them."""
        self._closed.set()
        self._follower.join()
        if cancel_futures:
            with ThreadPoolExecutor(16) as pool:  # every job takes a call of scancel
                list(pool.map(lambda job: job.cancel(check=False), self._running.values()))

    def _follow(self) -> None:
        """Take in the results, in a thread."""
        while not self._closed.wait(POLL):
            for future, job in list(self._running.items()):
                if job.done():
                    del self._running[future]
                    try:
                        future.set_result(job.result())
                    except Exception:  # submitit's words are the end of the log, which can be read
                        lost = f"its job {job.job_id} is {job.state} (output: {job.paths.stdout})"
                        future.set_exception(RuntimeError(lost))


class OutOfTime(RuntimeError):
    """A job has no more time, and would not have it in another try."""


def within_limit(function: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
    """Call a function in a job. Raises OutOfTime in it when Slurm says that the job's time is nearly over.

    submitit would hand in such a job again, without end where the site's limit is below the one set here.
    """
    began = time.monotonic()

    def over(*_: object) -> NoReturn:
        passed = duration(time.monotonic() - began)
        raise OutOfTime(f"its job was at its time limit after {passed}: set SBATCH_TIMELIMIT to more")

    signal.signal(signal.SIGUSR2, over)  # of submitit
    return function(*args, **kwargs)
