"""Compute tasks wherever an executor has processes: each once, tried again when its process dies or hangs.

A task is plain data (`Task`); nothing here knows what it computes, nor more of an executor than
`concurrent.futures.Executor`. The runner and the process that computes meet in the task's working folder
(`results.working`) alone, so that processes of this machine, Ray workers and Slurm jobs are the same to it. A task
whose result is there is skipped: the same tasks run again go on where the last run ended.
"""

import errno
import faulthandler
import json
import shutil
import signal
import time
import traceback
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from filelock import FileLock, Timeout

from experiments.study.results.working import LOCK, LOG, PROGRESS, last_words
from experiments.support.errors import FULL, UserError, disk_error, in_a_line
from experiments.support.files import made
from sumo_env.simulator import SimulatorError

RETRIES = 3  # a task that is lost is begun again at most so often
# Exit status of a process that faulthandler ends, and of one that must not be used again, by how its task ended.
HUNG, SPOILT = 1, {"lost": 70, "failed": 71}
POLL = 0.5  # [s] between two looks at the running tasks, and between two writes of progress.json
RECHECK = 2.0  # [s] that a process waits for a task that another run computes
# An error of these kinds awaits every task: the run stops instead of trying again.
DISK = {*FULL, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EPERM, errno.EIO, errno.ELOOP}

# Errors that come from around a task. It computes the same in each try, so any other one would only come again.
SURROUNDINGS = (OSError, EOFError, MemoryError, SimulatorError)

Heartbeat = Callable[[float], None]


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

    def compute(self, heartbeat: Heartbeat) -> None:
        """Compute and write the result, calling `heartbeat` with the share that is done."""


@dataclass(frozen=True)
class Attempt:
    """How a try ended.

    state: "done"; "elsewhere" if another process computes this task; "lost", to be tried again; "failed", as it would
    again; "fatal" if nothing else can succeed either, and `reason` is for the user.
    """

    state: Literal["done", "elsewhere", "lost", "failed", "fatal"]
    reason: str = ""


class Observer:
    """Is told what happens to the tasks; this one does not listen."""

    def tell(self, task: Task, state: str, words: str = "") -> None:
        """A task is now "running", "finished", "waiting" for another try or "failed" (words: why).

        "in another run": that one computes it.
        """

    def tick(self) -> None:
        """Called at least twice a second."""


# -- In the process that computes ------------------------------------------------------------------------------------


def attempt(task: Task) -> Attempt:
    """Compute a task unless its result is there or another process holds it; what executors run."""
    try:
        with locked(task.folder) as mine:
            if not mine:
                time.sleep(RECHECK)  # then the runner hands it out again, after all others
                return Attempt("elsewhere")
            with watched(task.folder, task.silence) as heartbeat:
                if not task.done():
                    task.compute(heartbeat)
            shutil.rmtree(task.folder, ignore_errors=True)
        return Attempt("done")
    except (Exception, SystemExit) as error:  # whatever goes wrong in one task must not end the others
        if isinstance(error, OSError) and error.errno in DISK:
            return Attempt("fatal", str(disk_error(error, task.folder)))
        said = isinstance(error, UserError)
        log(task.folder, str(error) if said else "".join(traceback.format_exception(error)))
        return Attempt("lost" if isinstance(error, SURROUNDINGS) else "failed", in_a_line(error))


def compute_here(task: Task) -> None:
    """Compute a task in this process, where a debugger can follow it and an error shows its traceback.

    Raises:
        UserError: another process computes it.
    """
    with locked(task.folder) as mine:
        if not mine:
            raise UserError(f"another process computes {task.name}: wait until it ends")
        if not task.done():
            task.compute(lambda _: None)
        shutil.rmtree(task.folder, ignore_errors=True)


def log(folder: Path, text: str) -> None:
    """Add some text, with the time, to a task's log. A full disk must not hide the error that is being logged."""
    with suppress(OSError), open(folder / LOG, "a") as file:
        file.write(f"--- {time.strftime('%Y-%m-%d %H:%M:%S')}\n{text.rstrip()}\n")


@contextmanager
def locked(folder: Path) -> Iterator[bool]:
    """Hold the lock of a working folder, which is made if it is missing; yields False if another process holds it."""
    while True:
        made(folder.parent), made(folder)
        lock = FileLock(folder / LOCK, timeout=0, fallback_to_soft=False)
        try:
            lock.acquire()
        except Timeout:
            yield False
            return
        except FileNotFoundError:  # whoever has just finished the task has removed its folder
            continue
        except OSError:  # no locks here: two sweeps may compute one task and get the same; one is kept
            pass
        break
    try:
        yield True
    finally:
        lock.release()


@contextmanager
def watched(folder: Path, silence: float) -> Iterator[Heartbeat]:
    """Yields the function by which a computation says that it goes on.

    After a silence the process writes its stacks to the log and ends itself; the timer is a thread in C, which works
    in a deadlock and in an endless loop of a library as well.
    """
    last = -POLL
    with open(folder / LOG, "a") as file:

        def heartbeat(fraction: float) -> None:
            nonlocal last
            now = time.monotonic()
            if now - last < POLL:
                return
            last = now
            faulthandler.dump_traceback_later(silence, exit=True, file=file)
            # a result says so itself if it cannot be written
            with suppress(OSError), open(folder / PROGRESS, "w") as progress:
                json.dump(fraction, progress)

        faulthandler.enable(file)
        heartbeat(0.0)
        try:
            yield heartbeat
        finally:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()


# -- In the process that hands out -----------------------------------------------------------------------------------


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
    observer = observer or Observer()
    waiting, running = deque(tasks), dict[Future[Attempt], Task]()
    tries, failures = Counter[str](), dict[str, str]()
    try:
        while waiting or running:
            while waiting and len(running) < limit:
                task = waiting.popleft()
                running[_submit(executor, task)] = task
                observer.tell(task, "running")
            for future in wait(running, POLL, FIRST_COMPLETED).done:
                task = running.pop(future)
                ended = _ending(task, future)
                tries[task.name] += ended.state == "lost"
                if ended.state == "fatal":
                    raise UserError(ended.reason)
                if ended.state == "done":
                    observer.tell(task, "finished")
                elif ended.state == "elsewhere":
                    waiting.append(task)
                    observer.tell(task, "in another run")
                elif ended.state == "lost" and tries[task.name] <= RETRIES:
                    waiting.appendleft(task)
                    again = f"retry {tries[task.name]} of {RETRIES}"
                    observer.tell(task, "waiting", f"{ended.reason}, see {task.folder / LOG}; {again}")
                else:
                    failures[task.name] = ended.reason
                    why = "it would again" if ended.state == "failed" else f"given up after {RETRIES} retries"
                    observer.tell(task, "failed", f"{ended.reason}; {why}")
            observer.tick()
    except BaseException:  # a signal of the user's, too
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    executor.shutdown()
    return failures


def _submit(executor: Executor, task: Task) -> Future[Attempt]:
    try:
        return executor.submit(attempt, task)
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise UserError(
            f"the executor takes no more tasks ({reason}): run the same command again to go on"
        ) from error


def _ending(task: Task, future: Future[Attempt]) -> Attempt:
    """How a task ended, also if its process, node or job was lost."""
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, UserError):
        return Attempt("fatal", str(error))
    code = getattr(error, "exitcode", None)  # pebble's ProcessExpired
    if code is None:
        reason = str(error).partition("\n")[0] or "its process was lost"  # an executor's own words
    elif code in SPOILT.values():
        return Attempt("lost" if code == SPOILT["lost"] else "failed", last_words(task.folder) or "it failed")
    elif code == HUNG:
        reason = f"it hung: no sign of life for {task.silence:.0f} s"
    elif code < 0:
        names = {number: number.name for number in signal.Signals}  # those for real time have none
        reason = f"its process was killed by {names.get(-code, f'signal {-code}')}"
    else:
        reason = f"its process ended with exit status {code}"
    log(task.folder, reason)
    return Attempt("lost", reason)
