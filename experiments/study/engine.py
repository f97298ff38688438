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

from experiments.study.claims import Claims
from experiments.study.grid import Cell
from experiments.study.progress import Display, Plain
from experiments.study.store import Store
from experiments.study.worker import Done, Failed, Job, MakeEnv, Progress, main
from experiments.support.errors import UserError

ATTEMPTS = 3  # a cell is begun at most this often
JOBS_PER_PROCESS = 25  # then a fresh process takes over: whatever a simulator leaks is given back
SILENCE = 900.0  # [s] a worker that reports nothing for so long hangs and is killed
RECHECK = 2.0  # [s] between looks at cells that another sweep computes


@dataclass
class Worker:
    """A worker process and what it is doing."""

    process: BaseProcess
    connection: Connection
    simulator: tuple[str, ...]
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
    """

    def __init__(
        self,
        directory: Path,
        cells: Sequence[Cell],
        workers: int,
        make_env: MakeEnv,
        seconds: Callable[[Cell], float],
    ) -> None:
        self.store = Store(directory)
        self.claims = Claims(directory / "claims")
        self.cells = {cell.name: cell for cell in cells}
        self.finished = {name for name, cell in self.cells.items() if self.store.is_finished(cell)}
        self.failed: dict[str, str] = {}
        self._seconds = seconds
        self._make_env = make_env
        self._context = multiprocessing.get_context("spawn")
        todo = [cell for name, cell in self.cells.items() if name not in self.finished]
        # The longest first, so that no process idles long at the end.
        self._queue = sorted((Job(cell, seconds(cell)) for cell in todo), key=lambda job: -job.cost)
        self._limit = workers
        self._workers: list[Worker] = []
        self._elsewhere: set[str] = set()  # cells that another sweep computes
        self._rechecked = 0.0
        self._display: Display = Plain()
        self._total = sum(job.cost for job in self._queue)

    def run(self, display: Display) -> None:
        """Work until every cell is finished or has failed; then `finished` and `failed` say which.

        Raises:
            UserError: the disk is full, a stored cell is damaged, or the like; everything finished is kept.
            KeyboardInterrupt: as it came; everything finished and all checkpoints are kept.
        """
        self._display = display
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
            free = next((worker for worker in self._workers if worker.job is None), None)
            job = self._next(free.simulator if free else None)
            if free and free.simulator != job.simulator:
                self._dismiss(free)
                free = None
            worker = free or self._spawn(job.simulator)
            worker.job, worker.fraction, worker.heard = (
                replace(job, attempts=job.attempts + 1),
                0.0,
                time.monotonic(),
            )
            worker.jobs += 1
            with suppress(ConnectionError):  # it died while it was idle: `_listen` sees that
                worker.connection.send(worker.job)

    def _next(self, simulator: tuple[str, ...] | None) -> Job:
        """Take the longest job that a process of this simulator can do; any job if there is none."""
        fitting = (number for number, job in enumerate(self._queue) if job.simulator == simulator)
        return self._queue.pop(next(fitting, 0))

    def _spawn(self, simulator: tuple[str, ...]) -> Worker:
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
        except (EOFError, ConnectionError):
            self._died(worker)
            return
        worker.heard = time.monotonic()
        if isinstance(message, Progress):
            worker.fraction = message.fraction
            return
        job, worker.job = worker.job, None
        assert job is not None
        if isinstance(message, Done):
            (self._elsewhere if message.elsewhere else self.finished).add(job.cell.name)
        elif isinstance(message, Failed):
            if message.fatal:
                raise UserError(message.message)
            self._again(job, message.message, message.details)
        # After an error nobody knows in what state the simulator is: the next try gets a fresh process.
        if isinstance(message, Failed) or worker.jobs >= JOBS_PER_PROCESS:
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
        """Put a cell that went wrong back into the queue, or give it up; note the details in a log."""
        name = job.cell.name
        log = self.store.directory / "logs" / f"{name}.txt"
        log.parent.mkdir(exist_ok=True)
        with log.open("a") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {reason}\n{details}\n")
        if job.attempts < ATTEMPTS:
            self._display.line(
                f"{name}: {reason}; trying again ({job.attempts + 1} of {ATTEMPTS}), see {log}"
            )
            self._queue.insert(0, job)
        else:
            self._display.line(f"{name}: {reason}; given up after {ATTEMPTS} tries, see {log}")
            self.failed[name] = reason

    def _recheck(self) -> None:
        """Look after the cells that other sweeps hold: take over what they dropped."""
        if not self._elsewhere or time.monotonic() - self._rechecked < RECHECK:
            return
        self._rechecked = time.monotonic()
        for name in sorted(self._elsewhere):
            cell = self.cells[name]
            if self.store.is_finished(cell):
                self.finished.add(name)
                self._elsewhere.discard(name)
            elif self.claims.holder(name) is None:
                self._queue.append(Job(cell, self._seconds(cell)))
                self._elsewhere.discard(name)

    def _show(self) -> None:
        open_jobs = [*self._queue, *(worker.job for worker in self._workers if worker.job)]
        left = sum(job.cost for job in open_jobs)
        left -= sum(worker.fraction * worker.job.cost for worker in self._workers if worker.job)
        fraction = min(max(1 - left / self._total, 0.0), 1.0) if self._total else 1.0
        running = ", ".join(worker.job.cell.slug for worker in self._workers if worker.job)
        if not running and self._elsewhere:
            holder = self.claims.holder(min(self._elsewhere))
            running = (
                f"waiting for {len(self._elsewhere)} cells of another sweep ({holder or 'just released'})"
            )
        self._display.update(fraction, len(self.finished), len(self.cells), running)

    def _dismiss(self, worker: Worker) -> None:
        """Let an idle worker end."""
        with suppress(ConnectionError):  # it is gone already
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
