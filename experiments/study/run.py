"""Compute tasks wherever an executor has processes: each once, tried again when it dies, hangs or fails.

A task is plain data (`Task`); nothing here knows what it computes, nor more of an executor than
`concurrent.futures.Executor`. The runner and the process that computes meet in the task's working folder alone, so that
processes of this machine, Ray workers and Slurm jobs are the same to it:

lock           held with flock by the process that computes; the kernel releases it, however the process ends
progress.json  {"fraction", "host", "pid"}; its age says whether the process is alive
log.txt        what went wrong, with the stack of every thread after a crash or a hang

A task whose result is there is skipped: the same tasks run again go on where the last run ended.
"""

from __future__ import annotations

import errno
import faulthandler
import fcntl
import json
import os
import shutil
import signal
import socket
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from experiments.support.errors import UserError, disk_error

LOCK, PROGRESS, LOG = "lock", "progress.json", "log.txt"
RETRIES = 3  # a task that goes wrong is begun again at most so often
SPOILT = 70  # exit status of a process that must not be used again; the log says what went wrong
POLL = 0.5  # [s] between two looks at the running tasks, and between two writes of progress.json
LOOKS = (
    200.0  # [1/s] files of progress read at most: with many workers, a shared file system is what is short
)
RECHECK = 5.0  # [s] between two tries at a task that another run computes
GRACE = 30.0  # [s] beyond a task's own limit of silence, after which a frozen or lost process is given up
# An error of these kinds awaits every task: the run stops instead of trying again.
DISK = {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO}
NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS}  # of a file system that knows no flock

Beat = Callable[[float], None]


class Task(Protocol):
    """Plain data that can be pickled, and a function of it that writes one result atomically.

    name: of the result. folder: working folder of this task alone; removed when it is done. silence: time without a
    sign of life after which it hangs [s].
    """

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def folder(self) -> Path: ...  # noqa: D102
    @property
    def silence(self) -> float: ...  # noqa: D102

    def done(self) -> bool:
        """Whether the result is there."""

    def compute(self, beat: Beat) -> str:
        """Compute and write the result, calling `beat` with the share that is done; returns a remark, or nothing."""


@dataclass(frozen=True)
class Ended:
    """How a try ended.

    state: "done"; "elsewhere" if another process computes this task; "failed", to be tried again; "fatal" if nothing
    else can succeed either, and `reason` is for the user. reason: of a "done" task, a remark for the user.
    """

    state: Literal["done", "elsewhere", "failed", "fatal"]
    reason: str = ""


@dataclass(frozen=True)
class Sign:
    """The last sign of life of a task: what progress.json says, and when it was written (by the file's clock)."""

    fraction: float
    host: str
    pid: int
    written: int


class Observer:
    """Is told what happens to the tasks; this one does not listen."""

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A task is now "running", "finished" (words: its remark), "waiting" for another try or "failed" (words: why).

        "in another run": that one computes it.
        """

    def tick(self, running: Mapping[str, Sign | None]) -> None:
        """Called twice a second, with many workers less often, with the signs of life of what runs, by task."""


# -- In the process that computes ------------------------------------------------------------------------------------


def attempt(task: Task) -> Ended:
    """Compute a task unless its result is there or another process holds it; what executors run."""
    try:
        with locked(task.folder) as mine:
            if not mine:
                return Ended("elsewhere")
            with watched(task.folder, task.silence) as beat:
                remark = "" if task.done() else task.compute(beat)
            shutil.rmtree(task.folder, ignore_errors=True)
        return Ended("done", remark)
    except UserError as error:
        return Ended("fatal", str(error))
    except Exception as error:  # whatever goes wrong in one task must not end the others
        if isinstance(error, OSError) and error.errno in DISK:
            return Ended("fatal", str(disk_error(error, task.folder)))
        log(task.folder, "".join(traceback.format_exception(error)))
        return Ended("failed", f"{type(error).__name__}: {error}".partition("\n")[0])


def compute_here(task: Task, beat: Beat = lambda _: None) -> None:
    """Compute a task in this process, where a debugger can follow it and an error shows its traceback.

    Raises:
        UserError: another process computes it.
    """
    with locked(task.folder) as mine:
        if not mine:
            raise UserError(f"another process computes {task.name}: wait until it ends")
        if not task.done():
            task.compute(beat)
        shutil.rmtree(task.folder, ignore_errors=True)


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
            file = (folder / LOCK).open("a")
        except FileNotFoundError:  # whoever has just finished the task has removed its folder
            continue
        with file:
            mine = _lock(file.fileno())
            if not mine or _is_same(file.fileno(), folder / LOCK):
                yield mine
                return


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
    last = -POLL
    here = {"host": socket.gethostname(), "pid": os.getpid()}
    with (folder / LOG).open("a") as file:

        def beat(fraction: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last < POLL:
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


# -- In the process that hands out -----------------------------------------------------------------------------------


def sign_of_life(folder: Path) -> Sign | None:
    """The last sign of life of a task; None if it gave none yet."""
    path = folder / PROGRESS
    try:
        value = json.loads(path.read_text())
        return Sign(float(value["fraction"]), str(value["host"]), int(value["pid"]), path.stat().st_mtime_ns)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def last_words(folder: Path) -> str:
    """The last line of a task's log, which names what went wrong."""
    try:
        return (folder / LOG).read_text().rstrip().rpartition("\n")[2]
    except OSError:
        return "it failed"


def run(
    tasks: Sequence[Task], executor: Executor, limit: int, observer: Observer | None = None
) -> dict[str, str]:
    """Compute the tasks whose results are not there yet, in this order; shuts the executor down.

    Args:
        limit: how many tasks are handed to the executor at a time.

    Returns:
        The reason of each failure by the name of its task. All other tasks are done.

    Raises:
        UserError: nothing can go on (the disk is full, say); everything finished is kept.
    """
    runner = _Run(tasks, executor, limit, observer or Observer())
    try:
        while runner.is_busy():
            runner.hand_out()
            runner.take()
            runner.watch()
    except BaseException:  # a signal of the user's, too
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    executor.shutdown()
    return runner.failures


class _Run:
    """The state of a run."""

    def __init__(self, tasks: Sequence[Task], executor: Executor, limit: int, observer: Observer) -> None:
        self.failures: dict[str, str] = {}
        self._executor, self._limit, self._observer = executor, limit, observer
        self._waiting = deque(tasks)
        self._later: deque[tuple[float, Task]] = deque()  # computed by another run: when to look again
        self._running: dict[Future[Ended], Task] = {}
        self._heard: dict[str, tuple[int, float]] = {}  # the last sign of life, and when it was seen here
        self._next_look = 0.0
        self._tries: Counter[str] = Counter()

    def is_busy(self) -> bool:
        return bool(self._waiting or self._running or self._later)

    def hand_out(self) -> None:
        """Give the executor what there is room for."""
        while self._later and self._later[0][0] <= time.monotonic():
            self._waiting.append(self._later.popleft()[1])
        while self._waiting and len(self._running) < self._limit:
            task = self._waiting.popleft()
            with suppress(OSError):  # that of an earlier try must not be taken for one of this
                (task.folder / PROGRESS).unlink(missing_ok=True)
            try:
                future = self._executor.submit(attempt, task)
            except Exception as error:
                reason = str(error).partition("\n")[0]
                raise UserError(
                    f"the executor takes no more tasks ({reason}): run the same command again to go on"
                ) from error
            self._running[future] = task
            self._tries[task.name] += 1
            self._observer.tell(task, "running")

    def take(self) -> None:
        """Wait a moment, and take in what has ended."""
        if not self._running:
            time.sleep(POLL)
            return
        for future in wait(self._running, POLL, FIRST_COMPLETED).done:
            task = self._running.pop(future)
            ended = self._ending(task, future)
            if ended.state == "done":
                self._observer.tell(task, "finished", ended.reason)
            elif ended.state == "elsewhere":
                self._tries[task.name] -= 1
                self._later.append((time.monotonic() + RECHECK, task))
                self._observer.tell(task, "in another run")
            elif ended.state == "fatal":
                raise UserError(ended.reason)
            else:
                self._failed(task, ended.reason)

    def _ending(self, task: Task, future: Future[Ended]) -> Ended:
        """How a task ended, also if its process was lost."""
        error = future.exception()
        _, heard = self._heard.pop(task.name, (0, time.monotonic()))
        if error is None:
            return future.result()
        if isinstance(error, UserError):
            return Ended("fatal", str(error))
        if (silence := time.monotonic() - heard) >= task.silence - POLL:
            reason = f"it hung: no sign of life for {silence:.0f} s"
        else:
            reason = _reason(task, error)
        if reason != last_words(task.folder):
            log(task.folder, reason)
        return Ended("failed", reason)

    def _failed(self, task: Task, reason: str) -> None:
        tries = self._tries[task.name]
        if tries <= RETRIES:
            self._waiting.appendleft(task)
            words = f"{reason}, see {task.folder / LOG}; retry {tries} of {RETRIES}"
            self._observer.tell(task, "waiting", words)
        else:
            self.failures[task.name] = reason
            self._observer.tell(task, "failed", reason)

    def watch(self) -> None:
        """Look at the signs of life. Processes end themselves after a silence, unless they are frozen or lost."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + len(self._running) / LOOKS
        signs = {task.name: sign_of_life(task.folder) for task in self._running.values()}
        for future, task in list(self._running.items()):
            sign = signs[task.name]
            if sign is None:
                continue
            written, seen = self._heard.get(task.name, (None, now))
            if written != sign.written:
                self._heard[task.name] = (sign.written, now)
            elif now - seen > task.silence + GRACE:
                future.cancel()  # kills a frozen process of this machine; others are given up
                del self._running[future], self._heard[task.name]
                self._failed(task, f"it hung: no sign of life from process {sign.pid} on {sign.host}")
        self._observer.tick(signs)


def _reason(task: Task, error: BaseException) -> str:
    """Why a process, node or job is lost."""
    code = getattr(error, "exitcode", None)  # pebble's ProcessExpired
    if code is None:
        return str(error).partition("\n")[0] or "its process was lost"  # an executor's own words
    if code == SPOILT:
        return last_words(task.folder)
    if code < 0:
        return f"its process was killed by {signal.Signals(-code).name}"
    return f"its process ended with exit status {code}"
