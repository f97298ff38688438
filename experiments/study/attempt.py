"""One try at a task, in whatever process an executor provides: locked, watched, logged, and answered in any case.

Everything between the runner and a worker goes through the task's working folder, so that it is the same for a process
of this machine, a Ray worker and a Slurm job:

lock           held with flock by the process that computes; the kernel releases it, however the process ends
progress.json  {"fraction", "host", "pid"}; its age says whether the process is alive
log.txt        what went wrong, with the stack of every thread after a crash or a hang
"""

from __future__ import annotations

import errno
import faulthandler
import fcntl
import json
import os
import shutil
import socket
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from experiments.support.errors import UserError, disk_error

LOCK, PROGRESS, LOG = "lock", "progress.json", "log.txt"
SPOILT = 70  # exit status of a process that must not be used again; the log says what went wrong
WRITE_EVERY = 0.5  # [s] between two writes of progress.json
# An error of these kinds awaits every task: the run stops instead of trying again.
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS}  # of a file system that knows no flock

Beat = Callable[[float], None]


class Task(Protocol):
    """Plain data that can be pickled, and a function of it that writes one result atomically.

    name: of the result. cost: expected time [s], or in any other unit that all tasks of a run share. folder: working
    folder of this task alone; removed when it is done. silence: time without a sign of life after which it hangs [s].
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def cost(self) -> float: ...  # noqa: D102
    @property
    def folder(self) -> Path: ...  # noqa: D102
    @property
    def silence(self) -> float: ...  # noqa: D102

    def done(self) -> bool:
        """Whether the result is there."""

    def compute(self, beat: Beat) -> str:
        """Compute the result and write it; returns a remark for the user, or nothing.

        Args:
            beat: to be called with the share that is done, now and then.
        """


@dataclass(frozen=True)
class Ended:
    """How a try ended.

    state: "done"; "elsewhere" if another process computes this task; "failed", to be tried again; "fatal" if nothing
    else can succeed either, and `reason` is for the user. reason: of a "done" task, a remark for the user.
    """

    state: Literal["done", "elsewhere", "failed", "fatal"]
    reason: str = ""


def last_words(folder: Path) -> str:
    """The last line of a task's log, which names what went wrong."""
    try:
        return (folder / LOG).read_text().rstrip().rpartition("\n")[2]
    except OSError:
        return "it failed"


@dataclass(frozen=True)
class Sign:
    """The last sign of life of a task: what progress.json says, and when it was written (by the file's clock)."""

    fraction: float
    host: str
    pid: int
    written: int


def attempt(task: Task) -> Ended:
    """Compute a task unless its result is there or another process holds it; what executors run."""
    try:
        with locked(task.folder) as mine:
            if not mine:
                return Ended("elsewhere")
            remark = ""
            if not task.done():
                with watched(task.folder, task.silence) as beat:
                    remark = task.compute(beat)
            shutil.rmtree(task.folder, ignore_errors=True)
        return Ended("done", remark)
    except UserError as error:
        return Ended("fatal", str(error))
    except OSError as error:
        if error.errno in DISK:
            return Ended("fatal", str(disk_error(error, task.folder)))
        return _failed(task.folder, error)
    except Exception as error:  # whatever goes wrong in one task must not end the others
        return _failed(task.folder, error)


def _failed(folder: Path, error: Exception) -> Ended:
    log(folder, "".join(traceback.format_exception(error)))
    return Ended("failed", f"{type(error).__name__}: {error}".partition("\n")[0])


def log(folder: Path, text: str) -> None:
    """Add some text, with the time, to a task's log. A full disk must not hide the error that is being logged."""
    with suppress(OSError), (folder / LOG).open("a") as file:
        file.write(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')}\n{text.rstrip()}\n")


@contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Hold the lock of a working folder, which is made if it is missing; yields False if another process holds it."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
        except FileNotFoundError:  # whoever has just finished the task has removed its folder
            continue
        try:
            mine = _lock(descriptor)
            if not mine or _is_same(descriptor, folder / LOCK):
                yield mine
                return
        finally:
            os.close(descriptor)


def _lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        # Without locks two sweeps may compute one task. They get the same result, and one of the two is kept.
        if error.errno not in NO_LOCKS:
            raise
    return True


def _is_same(descriptor: int, path: Path) -> bool:
    """Whether a path still names an open file: it may have been removed before the lock was taken."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


@contextmanager
def watched(folder: Path, silence: float) -> Iterator[Beat]:
    """Yields the function by which a computation says that it goes on.

    After a silence the process writes its stacks to the log and ends itself; the timer is a thread in C, which works
    in a deadlock and in an endless loop of a library as well.
    """
    last = -WRITE_EVERY
    here = {"host": socket.gethostname(), "pid": os.getpid()}
    with (folder / LOG).open("a") as file:

        def beat(fraction: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last < WRITE_EVERY:
                return
            last = now
            faulthandler.dump_traceback_later(silence, exit=True, file=file)
            temporary = folder / f".{PROGRESS}.tmp"
            with suppress(OSError):  # a result says so itself if it cannot be written
                temporary.write_text(json.dumps({"fraction": min(max(fraction, 0.0), 1.0), **here}))
                os.replace(temporary, folder / PROGRESS)

        faulthandler.enable(file)
        beat(0.0)
        try:
            yield beat
        finally:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()


def sign_of_life(folder: Path) -> Sign | None:
    """The last sign of life of a task; None if it gave none yet."""
    path = folder / PROGRESS
    try:
        value = json.loads(path.read_text())
        return Sign(float(value["fraction"]), str(value["host"]), int(value["pid"]), path.stat().st_mtime_ns)
    except (OSError, ValueError, KeyError, TypeError):
        return None
