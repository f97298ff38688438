"""Supervises the worker processes: hands out jobs, notices deaths, tries again, keeps what is finished."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from experiments.claims import Claims
from experiments.errors import UserError
from experiments.grid import Cell
from experiments.jobs import Job, plan
from experiments.progress import Display
from experiments.store import Store
from experiments.worker import Done, Failed, MakeEnv, Progress, begun, main

ATTEMPTS = 3  # a job is begun at most this often
JOBS_PER_PROCESS = 8  # then a fresh process takes over: whatever a simulator leaks is given back
SILENCE = 900.0  # [s] a worker that reports nothing for so long hangs and is killed
RECHECK = 2.0  # [s] between looks at cells that another sweep computes


@dataclass
class Worker:
    """A worker process and what it is doing."""

    process: BaseProcess
    connection: Connection
    simulator: tuple[str, str]
    job: Job | None = None
    fraction: float = 0.0
    jobs: int = 0
    heard: float = field(default_factory=time.monotonic)


class Engine:
    """Computes the unfinished ones of some cells with several processes.

    Args:
        directory: where results are stored.
        cells: what is wanted; those that are stored are not computed again.
        workers: number of processes.
        make_env: makes an environment from (backend, task, config); must be importable in another process.
        seconds: expected time of a cell on one core.
        display: shows the progress.
    """

    def __init__(
        self,
        directory: Path,
        cells: Sequence[Cell],
        workers: int,
        make_env: MakeEnv,
        seconds: Callable[[Cell], float],
        display: Display,
    ) -> None:
        self.store = Store(directory)
        self.claims = Claims(directory / "claims")
        self.cells = {cell.name: cell for cell in cells}
        self.finished = {name for name, cell in self.cells.items() if self.store.is_finished(cell)}
        self.failed: dict[str, str] = {}
        self._seconds = seconds
        self._display = display
        self._make_env = make_env
        self._context = multiprocessing.get_context("spawn")
        self._queue = plan(cells, self.finished, workers, seconds, begun(directory))
        self._limit = min(workers, max(len(self._queue), 1))
        self._workers: list[Worker] = []
        self._elsewhere: set[str] = set()  # cells that another sweep computes
        self._rechecked = 0.0
        self._total = sum(job.cost for job in self._queue)

    def run(self) -> None:
        """Work until every cell is finished or has failed; then `finished` and `failed` say which.

        Raises:
            UserError: the disk is full, a stored cell is damaged, or the like; everything finished is kept.
            KeyboardInterrupt: as it came; everything finished and all checkpoints are kept.
        """
        try:
            while self._queue or self._elsewhere or any(worker.job for worker in self._workers):
                self._start()
                self._listen()
                self._recheck()
                self._show()
        finally:
            self._stop()
            self._display.close()

    def _start(self) -> None:
        """Give every free worker a job, in a process that serves the job's simulator."""
        while self._queue and sum(worker.job is not None for worker in self._workers) < self._limit:
            job = self._queue.pop(0)
            worker = next((w for w in self._workers if w.job is None and w.simulator == job.simulator), None)
            if worker is None:
                for idle in [w for w in self._workers if w.job is None]:
                    self._dismiss(idle)
                worker = self._spawn(job.simulator)
            worker.job, worker.fraction, worker.heard = (
                replace(job, attempts=job.attempts + 1),
                0.0,
                time.monotonic(),
            )
            worker.jobs += 1
            with suppress(BrokenPipeError):  # it died while it was idle: `_listen` sees that
                worker.connection.send(worker.job)

    def _spawn(self, simulator: tuple[str, str]) -> Worker:
        ours, theirs = self._context.Pipe()
        arguments = (theirs, self.store.directory, self._make_env, os.getpid())
        process = self._context.Process(target=main, args=arguments, daemon=True)
        process.start()
        theirs.close()
        worker = Worker(process, ours, simulator)
        self._workers.append(worker)
        return worker

    def _listen(self) -> None:
        """Wait for news from the workers, for half a second at most."""
        handles: list[Any] = [worker.connection for worker in self._workers]
        handles += [worker.process.sentinel for worker in self._workers]
        ready = wait(handles, timeout=0.5)
        for worker in list(self._workers):
            if worker.connection in ready:
                self._receive(worker)
            elif worker.process.sentinel in ready:
                self._died(worker)
            elif worker.job and time.monotonic() - worker.heard > SILENCE:
                worker.process.kill()

    def _receive(self, worker: Worker) -> None:
        try:
            message = worker.connection.recv()
        except (EOFError, ConnectionResetError):
            self._died(worker)
            return
        worker.heard = time.monotonic()
        if isinstance(message, Progress):
            worker.fraction = message.fraction
            return
        job, worker.job = worker.job, None
        assert job is not None
        if isinstance(message, Done):
            self._elsewhere |= set(message.busy)
            self.finished |= {cell.name for cell in job.cells} - set(message.busy)
        elif isinstance(message, Failed):
            if message.fatal:
                raise UserError(message.message)
            self._again(job, message.message, message.details)
        if worker.jobs >= JOBS_PER_PROCESS:
            self._dismiss(worker)

    def _died(self, worker: Worker) -> None:
        worker.process.join()
        self._workers.remove(worker)
        worker.connection.close()
        if worker.job:
            code = worker.process.exitcode or 0
            how = f"killed by signal {-code}" if code < 0 else f"ended with exit status {code}"
            self._again(worker.job, f"its process was {how}" if code < 0 else f"its process {how}")

    def _again(self, job: Job, reason: str, details: str = "") -> None:
        """Put a job that went wrong back into the queue, or give its cells up.

        The last attempt is made with each cell alone: a cell that fails must not take its cohort with it.
        """
        names = [cell.name for cell in job.cells]
        log = self._log(names, reason, details)
        if job.attempts < ATTEMPTS:
            self._display.line(
                f"{job.label}: {reason}; trying again ({job.attempts + 1} of {ATTEMPTS}), see {log}"
            )
            alone = job.attempts == ATTEMPTS - 1
            groups = [(cell,) for cell in job.cells] if alone else [job.cells]
            self._queue[:0] = [Job(cells, sum(map(self._seconds, cells)), job.attempts) for cells in groups]
        else:
            for name in names:
                self.failed[name] = reason
                self._display.line(f"{name} failed {ATTEMPTS} times: {reason}, see {log}")

    def _log(self, names: list[str], reason: str, details: str) -> Path:
        path = self.store.directory / "logs" / f"{names[0]}.txt"
        path.parent.mkdir(exist_ok=True)
        with path.open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {', '.join(names)}\n{reason}\n{details}\n")
        return path

    def _recheck(self) -> None:
        """Look after the cells that other sweeps hold: take over what they dropped."""
        if not self._elsewhere or time.monotonic() - self._rechecked < RECHECK:
            return
        self._rechecked = time.monotonic()
        dropped = []
        for name in sorted(self._elsewhere):
            cell = self.cells[name]
            if self.store.is_finished(cell):
                self.finished.add(name)
                self._elsewhere.discard(name)
            elif self.claims.holder(name) is None:
                dropped.append(cell)
                self._elsewhere.discard(name)
        if dropped:
            self._queue += plan(dropped, set(), self._limit, self._seconds, begun(self.store.directory))

    def _show(self) -> None:
        open_jobs = [*self._queue, *(worker.job for worker in self._workers if worker.job)]
        left = sum(job.cost for job in open_jobs)
        left -= sum(worker.fraction * worker.job.cost for worker in self._workers if worker.job)
        fraction = min(max(1 - left / self._total, 0.0), 1.0) if self._total else 1.0
        running = ", ".join(worker.job.label for worker in self._workers if worker.job)
        if not running and self._elsewhere:
            holder = self.claims.holder(min(self._elsewhere))
            running = (
                f"waiting for {len(self._elsewhere)} cells of another sweep ({holder or 'just released'})"
            )
        self._display.update(fraction, len(self.finished), len(self.cells), running)

    def _dismiss(self, worker: Worker) -> None:
        """Let an idle worker end."""
        with suppress(BrokenPipeError):  # it is gone already
            worker.connection.send(None)
        worker.process.join(10)
        worker.process.kill()
        worker.process.join()
        worker.connection.close()
        self._workers.remove(worker)

    def _stop(self) -> None:
        """End all workers; a running job goes on from its last checkpoint the next time."""
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(5)
            worker.process.kill()
            worker.process.join()
            worker.connection.close()
        self._workers.clear()
