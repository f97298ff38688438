"""Processes of this machine."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from typing import Any

from experiments.support.processes import end_with_parent


class LocalExecutor(ThreadPoolExecutor):
    """Spawned processes, each a pool of one: the death of one takes no other along and says whose task it was.

    Args:
        workers: number of processes.
        tasks_per_process: then a fresh process takes over, so that whatever a simulator leaks is given back.
        spoilt: tells from a task's result whether its process may be used again.
    """

    def __init__(self, workers: int, tasks_per_process: int, spoilt: Callable[[Any], bool] = lambda _: False):
        resource_tracker.ensure_running()  # here: it unblocks signals in the thread that starts it
        super().__init__(workers, initializer=_block_interrupts)
        self._tasks_per_process, self._spoilt = tasks_per_process, spoilt
        self._mine = threading.local()
        self._all: list[_Process] = []
        self._closed = False

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in one of the processes."""
        return super().submit(self._call, function, args, kwargs)

    def _call(self, function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """Run in a thread of this process, which has one worker process of its own."""
        process: _Process | None = getattr(self._mine, "process", None)
        if process is None:
            process = self._mine.process = _Process()
            self._all.append(process)
        if self._closed:
            raise WorkerDied("it was stopped")
        reuse = False
        try:
            result = process.call(function, args, kwargs)
            reuse = process.calls < self._tasks_per_process and not self._spoilt(result)
            return result
        finally:
            if not reuse:
                self._mine.process = None
                self._all.remove(process)
                process.close(wait=self._closed)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their tasks, or at once with `cancel_futures`, which waits until they have ended."""
        self._closed = cancel_futures
        if cancel_futures:
            wait = True  # it is short, and the exit handlers of Python fail on a pool that is just closing
            for process in list(self._all):
                process.kill()
        super().shutdown(wait, cancel_futures=cancel_futures)
        for process in list(self._all):
            process.close(wait)


class WorkerDied(RuntimeError):
    """A process ended in the middle of a task."""


class _Context(SpawnContext):
    """Remembers the process that is started by it."""

    started: BaseProcess | None = None

    def Process(self, *args: Any, **kwargs: Any) -> Any:  # type: ignore[override]
        self.started = super().Process(*args, **kwargs)
        return self.started


class _Process:
    """A pool of one process."""

    def __init__(self) -> None:
        self._context = _Context()
        self._pool = ProcessPoolExecutor(1, self._context, initializer=end_with_parent)
        self.calls = 0

    def call(self, function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        self.calls += 1
        try:
            return self._pool.submit(function, *args, **kwargs).result()
        except BrokenProcessPool:
            raise WorkerDied(self._ending()) from None

    def _ending(self) -> str:
        process = self._context.started
        if process is None:
            return "its process could not be started"
        # The pool's own thread waits for it too: whoever is second sees no status until the first has it.
        deadline = time.monotonic() + 5.0
        while (code := process.exitcode) is None and time.monotonic() < deadline:
            time.sleep(0.01)
        if code is not None and code < 0:
            return f"its process was killed by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code}"

    def kill(self) -> None:
        if self._context.started is not None:
            self._context.started.kill()

    def close(self, wait: bool) -> None:
        self._pool.shutdown(wait)


def _block_interrupts() -> None:
    """Ctrl-C reaches all processes of a terminal; those that this thread starts leave it to their parent."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
