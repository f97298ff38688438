"""An object in a process of its own, and the slices of work that its methods are timed by.

libsumo holds one simulation a process, highway-env's tasks change class attributes, and memory can only be
weighed where nothing else lives: whatever is measured gets a process. Two such processes take turns and never
run at the same time, so that both meet the same machine.
"""

from __future__ import annotations

import multiprocessing
import statistics
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any

from experiments.support.threads import limit_threads


class MeasurementFailed(RuntimeError):
    """A measuring process raised or died; the message says where."""


@dataclass(frozen=True)
class Slice:
    """A stretch of work: how much of it, in which wall and processor time [s]."""

    count: int
    wall: float
    cpu: float

    @property
    def per_second(self) -> float:
        """Rate in processor time: what one core does, whoever else uses the machine."""
        return self.count / self.cpu

    @property
    def wall_per_second(self) -> float:
        """Rate in wall time."""
        return self.count / self.wall


class Stopwatch:
    """Wall and processor time of this process since the start [s]."""

    def __init__(self) -> None:
        self._wall, self._cpu = time.perf_counter(), time.process_time()

    @property
    def wall(self) -> float:
        """Wall time [s]."""
        return time.perf_counter() - self._wall

    @property
    def cpu(self) -> float:
        """Processor time, of all threads [s]."""
        return time.process_time() - self._cpu

    def slice(self, count: int) -> Slice:
        """The stretch up to now."""
        return Slice(count, self.wall, self.cpu)


def total(slices: Iterable[Slice]) -> Slice:
    """All of them together."""
    parts = list(slices)
    return Slice(sum(p.count for p in parts), sum(p.wall for p in parts), sum(p.cpu for p in parts))


def median_rate(slices: Sequence[Slice]) -> float:
    """Median over the slices of what one second of processor time brings."""
    return statistics.median(part.per_second for part in slices)


def median_wall_rate(slices: Sequence[Slice]) -> float:
    """Median over the slices of what one second brings."""
    return statistics.median(part.wall_per_second for part in slices)


def median_ratio(ours: Sequence[Slice], theirs: Sequence[Slice]) -> float:
    """Median over the repeats of our rate over theirs; each repeat's two slices were taken in turn."""
    return statistics.median(a.per_second / b.per_second for a, b in zip(ours, theirs, strict=True))


def resident_mib() -> float:
    """Resident memory of this process [MiB] (Linux; elsewhere the peak)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        import resource

        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return pages * 4096 / 2**20


class Remote:
    """An object in a spawned process: ``remote.call("method", ...)`` returns what the method returns.

    Args:
        factory: makes the object, in the process; an importable function or class.
        arguments: its arguments.
    """

    def __init__(self, factory: Callable[..., Any], *arguments: Any) -> None:
        limit_threads()  # inherited by the process, which imports numpy before anything of ours runs
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        # no daemon: vectors of environments start processes of their own
        self._process = context.Process(target=_serve, args=(theirs, factory, arguments))
        self._process.start()
        theirs.close()
        self._ready = False

    def wait(self) -> None:
        """Wait until the object is made, so that its imports are in nobody's time."""
        if not self._ready:
            self._answer()
            self._ready = True

    def call(self, method: str, *arguments: Any) -> Any:
        """Call a method of the object.

        Raises:
            MeasurementFailed: the method raised, or the process died.
        """
        self.start(method, *arguments)
        return self._answer()

    def start(self, method: str, *arguments: Any) -> None:
        """Call a method without waiting for it; `result` waits."""
        self.wait()
        self._connection.send((method, arguments))

    def result(self) -> Any:
        """What the method that was started last returns. Raises as `call` does."""
        return self._answer()

    def _answer(self) -> Any:
        try:
            error, value = self._connection.recv()
        except EOFError:
            self._process.join()
            raise MeasurementFailed(
                f"a measuring process ended with exit status {self._process.exitcode}"
            ) from None
        if error:
            raise MeasurementFailed(f"in a measuring process:\n{error}")
        return value

    def close(self) -> None:
        """End the process."""
        self._connection.close()  # it leaves by itself when nobody is there to talk to
        self._process.join(10)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def __enter__(self) -> Remote:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _serve(connection: Connection, factory: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """The other process: make the object, then answer calls until nobody asks any more."""

    def attempt(work: Callable[[], Any]) -> bool:
        try:
            value = work()
        except Exception:  # whatever it is, the asking process reports it
            connection.send((traceback.format_exc(), None))
            return False
        connection.send((None, value))
        return True

    made: list[Any] = []
    if not attempt(lambda: made.append(factory(*arguments))):
        return
    while True:
        try:
            method, values = connection.recv()
        except (EOFError, KeyboardInterrupt):
            return
        attempt(lambda: getattr(made[0], method)(*values))  # noqa: B023 (called at once)
