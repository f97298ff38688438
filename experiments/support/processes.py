"""Worker processes that end with the process that started them."""

from __future__ import annotations

import fcntl
import multiprocessing
import os
import signal
from collections.abc import Callable, Mapping
from concurrent.futures import Future, as_completed
from multiprocessing import parent_process

from pebble import ProcessPool
from rich.console import Console
from rich.progress import track

from experiments.support.errors import UserError

CALLS_PER_PROCESS = 25  # then a fresh process takes over, so that whatever a simulator leaks is given back


def end_with_parent() -> None:
    """Let the kernel end this process when its parent ends, however that happens; for initialisers of process pools.

    multiprocessing gives every spawned process a pipe whose other end the parent holds. Its closing raises SIGIO, which
    ends a process by default, in the middle of a compiler's long call into C as well: a thread that watched the parent
    would wait there for the interpreter's lock.
    """
    parent = parent_process()
    assert parent is not None
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    fcntl.fcntl(parent.sentinel, fcntl.F_SETOWN, os.getpid())
    fcntl.fcntl(parent.sentinel, fcntl.F_SETFL, fcntl.fcntl(parent.sentinel, fcntl.F_GETFL) | os.O_ASYNC)
    if not parent.is_alive():  # it ended before
        os._exit(1)


def call_all(
    work: Mapping[str, Callable[[], None]], workers: int, doing: str, console: Console | None = None
) -> None:
    """Call functions, each of which writes a result, in spawned processes.

    Args:
        work: the functions by the names of their results.
        doing: what they do, as one word.
        console: where progress is shown, if at all.

    Raises:
        UserError: one failed; those that still run are given up.
    """
    pool = ProcessPool(
        workers, CALLS_PER_PROCESS, end_with_parent, context=multiprocessing.get_context("spawn")
    )
    try:
        running: dict[Future[None], str] = {pool.schedule(call): name for name, call in work.items()}
        finished = as_completed(running)
        for future in track(finished, doing, len(work), console=console, disable=console is None):
            if error := future.exception():
                raise UserError(f"{running[future]} failed ({error}): run the same command again to go on")
    finally:
        pool.stop()  # on an error or Ctrl-C, whatever is running is given up
        pool.join()
