"""The runner: hands tasks to an executor, tries again what dies, hangs or fails, and says what is missing.

It knows nothing of the study and nothing of the executor but `concurrent.futures.Executor`. A task is skipped when its
result is there (see `attempt`), so running the same tasks again goes on where the last run ended.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from contextlib import suppress
from types import FrameType
from typing import Generic, TypeVar

from experiments.study.attempt import (
    LOG,
    PROGRESS,
    SPOILT,
    Ended,
    Sign,
    Task,
    attempt,
    last_words,
    log,
    sign_of_life,
)
from experiments.support.errors import INTERRUPTED, UserError

RETRIES = 3  # a task that goes wrong is begun again at most so often
POLL = 0.5  # [s] between two looks at the running tasks
LOOKS = 200.0  # [1/s] signs of life read at most: with many workers, a shared file system is what is short
RECHECK = 5.0  # [s] between two tries at a task that another run computes
GRACE = (
    30.0  # [s] beyond a task's own limit of silence, after which the runner kills a process that is frozen
)
LEAVE = 4.0  # [s] after a signal in which the process ends in any case

T = TypeVar("T", bound=Task)


class Observer(Generic[T]):
    """Is told everything that happens to the tasks; does nothing by itself."""

    def started(self, task: T) -> None:
        """A try begins, or waits in the executor's queue."""

    def finished(self, task: T, remark: str) -> None:
        """The result is there; the remark is usually empty."""

    def again(self, task: T, reason: str, number: int) -> None:
        """It went wrong and is retried, for the `number`-th time."""

    def failed(self, task: T, reason: str) -> None:
        """It went wrong for the last time."""

    def elsewhere(self, task: T) -> None:
        """Another run computes it."""

    def tick(self, running: Mapping[str, Sign | None]) -> None:
        """Called twice a second, with many workers less often, with the signs of life of what runs, by task."""


class Stop:
    """SIGINT and SIGTERM end the process within five seconds, wherever it is, with one line and status 130.

    The runner looks at `requested` twice a second and ends in order; anything else is cut off after LEAVE seconds,
    which harms nothing: every file is written atomically.

    Args:
        line: makes the line that says how to go on.
    """

    def __init__(self, line: Callable[[], str]) -> None:
        self.requested = False
        self._line = line
        self._said = threading.Lock()

    def __enter__(self) -> Stop:
        self._before = {
            number: signal.signal(number, self._receive) for number in (signal.SIGINT, signal.SIGTERM)
        }
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if not self.requested:
            self.requested = True
            timer = threading.Timer(LEAVE, self._leave)
            timer.daemon = True
            timer.start()

    def say(self) -> None:
        """Print the line, once."""
        if self._said.acquire(blocking=False):
            print(f"\n{self._line()}", file=sys.stderr, flush=True)

    def _leave(self) -> None:
        self.say()
        os._exit(INTERRUPTED)


class Interrupted(Exception):
    """A run was stopped by a signal; everything finished and all checkpoints are kept."""


def run(
    tasks: Sequence[T],
    executor: Executor,
    limit: int,
    observer: Observer[T] | None = None,
    stop: Stop | None = None,
) -> dict[str, str]:
    """Compute the tasks whose results are not there yet, the most costly first; shuts the executor down.

    Args:
        limit: how many tasks are handed to the executor at a time.
        stop: ends the run when a signal has come.

    Returns:
        The reason of each failure by the name of its task. All other tasks are done.

    Raises:
        UserError: nothing can go on (the disk is full, say); everything finished is kept.
        Interrupted: a signal came.
    """
    runner = _Run(tasks, executor, limit, observer or Observer())
    try:
        while runner.is_busy():
            runner.hand_out()
            ended = runner.wait()
            if stop is not None and stop.requested:
                raise Interrupted  # before what a signal to the whole group has done to the workers is looked at
            runner.take(ended)
    except BaseException:
        executor.shutdown(wait=False, cancel_futures=True)
        raise
    executor.shutdown()
    return runner.failures


class _Run(Generic[T]):
    """The state of a run."""

    def __init__(self, tasks: Sequence[T], executor: Executor, limit: int, observer: Observer[T]) -> None:
        self.failures: dict[str, str] = {}
        self._executor, self._limit, self._observer = executor, limit, observer
        self._waiting = deque(sorted(tasks, key=lambda task: -task.cost))
        self._later: deque[tuple[float, T]] = deque()  # computed by another run: when to look again
        self._running: dict[Future[Ended], T] = {}
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
            self._observer.started(task)

    def wait(self) -> set[Future[Ended]]:
        """Wait a moment for something to end."""
        if self._running:
            return wait(self._running, POLL, FIRST_COMPLETED).done
        time.sleep(POLL)
        return set()

    def take(self, ended: set[Future[Ended]]) -> None:
        """Take in what has ended, and look after the rest."""
        for future in ended:
            self._end(self._running.pop(future), future)
        if time.monotonic() >= self._next_look:
            self._watch()
            self._next_look = time.monotonic() + len(self._running) / LOOKS

    def _end(self, task: T, future: Future[Ended]) -> None:
        error = future.exception()
        _, heard = self._heard.pop(task.name, (0, time.monotonic()))
        if isinstance(error, UserError):
            raise error
        if error is None:
            ended = future.result()
        elif (silence := time.monotonic() - heard) >= task.silence - POLL:
            ended = Ended("failed", f"it hung: no sign of life for {silence:.0f} s")
        else:
            ended = Ended("failed", _reason(task, error))
        if ended.state == "done":
            self._observer.finished(task, ended.reason)
        elif ended.state == "elsewhere":
            self._tries[task.name] -= 1
            self._later.append((time.monotonic() + RECHECK, task))
            self._observer.elsewhere(task)
        elif ended.state == "fatal":
            raise UserError(ended.reason)
        else:
            if error is not None and ended.reason != last_words(task.folder):
                log(task.folder, ended.reason)
            self._failed(task, ended.reason)

    def _failed(self, task: T, reason: str) -> None:
        tries = self._tries[task.name]
        if tries <= RETRIES:
            self._waiting.appendleft(task)
            self._observer.again(task, f"{reason}, see {task.folder / LOG}", tries)
        else:
            self.failures[task.name] = reason
            self._observer.failed(task, reason)

    def _watch(self) -> None:
        """Look at the signs of life. Processes end themselves in a silence, but for those that are frozen or lost."""
        signs = {task.name: sign_of_life(task.folder) for task in self._running.values()}
        now = time.monotonic()
        for future, task in list(self._running.items()):
            sign = signs[task.name]
            if sign is None:
                continue
            seen = self._heard.get(task.name)
            if seen is None or seen[0] != sign.written:
                self._heard[task.name] = (sign.written, now)
            elif now - seen[1] > task.silence + GRACE:
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
