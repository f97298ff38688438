"""Processes of this machine, by pebble. If one dies, the others continue, and the error names its task.

Workers end when the process that started them ends.
"""

import os
import signal
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future
from contextlib import suppress
from multiprocessing import parent_process, resource_tracker
from multiprocessing.context import SpawnContext
from multiprocessing.synchronize import RLock
from typing import Any

from pebble import ProcessPool

from experiments.study.compute.run import SPOILT, Attempt

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

TASKS_PER_PROCESS = 25  # then a fresh process takes over, so that whatever a simulator leaks is given back


def end_with_parent() -> None:
    """Let the kernel end this process when its parent ends, however that happens; for initialisers of process pools.

    multiprocessing gives every spawned process a pipe whose other end the parent holds. Its closing raises SIGIO, which
    ends a process by default, in the middle of a compiler's long call into C as well. Where the kernel cannot do so, as
    on Windows, a thread watches the parent; after such a call, it waits for the interpreter's lock.
    """
    parent = parent_process()
    assert parent is not None
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if fcntl is None:
        threading.Thread(target=lambda: (parent.join(), os._exit(1)), daemon=True).start()
        return
    fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    if not parent.is_alive():  # it ended before
        os._exit(1)


class KeepsLocks(SpawnContext):
    """Spawns processes, and keeps their locks.

    pebble drops the locks of a pool, and with them the semaphores, before it ends the processes: one that is still
    starting would miss them and print a traceback.
    """

    def __init__(self) -> None:
        self._locks: list[RLock] = []

    def RLock(self) -> RLock:
        """A lock that stays until this context is gone."""
        self._locks.append(super().RLock())
        return self._locks[-1]


class LocalExecutor(Executor):
    """So many spawned processes. tasks_per_process: then a fresh one takes over."""

    def __init__(self, workers: int, tasks_per_process: int = TASKS_PER_PROCESS) -> None:
        resource_tracker.ensure_running()  # here: it unblocks signals in the thread that starts it
        self._workers, self._tasks_per_process = workers, tasks_per_process
        self._pool = self._open()

    def _open(self) -> ProcessPool:
        return ProcessPool(
            self._workers,
            max_tasks=self._tasks_per_process,
            initializer=end_with_parent,
            context=KeepsLocks(),
        )

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in one of the processes; to cancel the future kills the process."""
        # Ctrl-C reaches all processes of a terminal; those that are started from here leave it to their parent.
        before = _sigmask("SIG_BLOCK", {signal.SIGINT})
        try:
            try:
                return self._pool.schedule(_call, args=[function, args, kwargs])
            except RuntimeError:  # pebble gives up a pool whose only busy process is killed between two tasks
                with suppress(OSError):  # some of its processes may have ended
                    self._pool.stop()
                    self._pool.join()
                self._pool = self._open()
                return self._pool.schedule(_call, args=[function, args, kwargs])
        finally:
            _sigmask("SIG_SETMASK", before)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes: after their tasks, or at once with `cancel_futures`."""
        if cancel_futures:
            self._pool.stop()
        else:
            self._pool.close()
        # At once is short, and Python's own exit handlers fail on a pool that is closing.
        if wait or cancel_futures:
            self._pool.join()


def _sigmask(how: str, signals: Iterable[int]) -> set[int]:
    """`signal.pthread_sigmask`, where there is one."""
    mask = getattr(signal, "pthread_sigmask", None)
    return mask(getattr(signal, how), signals) if mask else set()


def _call(function: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
    result = function(*args, **kwargs)
    # After an error nobody knows in what state a simulator is: the next try gets a fresh process.
    if isinstance(result, Attempt) and result.state in SPOILT:
        os._exit(SPOILT[result.state])
    return result
