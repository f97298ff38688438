"""Worker processes that end with the process that started them."""

from __future__ import annotations

import fcntl
import os
import signal
from multiprocessing import parent_process


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
