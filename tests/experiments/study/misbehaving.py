"""Tasks for tests of the runner: each adds up a few numbers, and some die, hang or fail on the way."""

import ctypes
import errno
import os
import signal
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path

from experiments.study.compute.run import Heartbeat
from experiments.support.errors import UserError
from experiments.support.files import write_file

STEPS = 10


@dataclass(frozen=True)
class Sum:
    """Adds up some numbers, one a step; writes the sum to DIRECTORY/NAME.

    fault: what goes wrong after half of the steps. times: in how many tries it goes wrong.
    """

    name: str
    directory: Path
    fault: str = ""
    times: int = 0
    pause: float = 0.0
    silence: float = 60.0

    @property
    def folder(self) -> Path:
        return self.directory / "work" / self.name

    @property
    def result(self) -> Path:
        return self.directory / self.name

    def done(self) -> bool:
        return self.result.exists()

    def compute(self, heartbeat: Heartbeat) -> None:
        with (self.directory / f"{self.name}.tries").open("a") as file:
            file.write(f"{os.getpid()}\n")
        total = 0
        for step in range(STEPS):
            heartbeat(step / STEPS)
            if step == STEPS // 2:
                self._misbehave()
            time.sleep(self.pause)
            total += step
        write_file(self.result, str(total).encode())

    def tries(self) -> list[int]:
        """The process of each try."""
        return list(map(int, (self.directory / f"{self.name}.tries").read_text().split()))

    def _misbehave(self) -> None:
        if self.fault and len(self.tries()) <= self.times:
            FAULTS[self.fault]()


def _hold_everything() -> None:
    """An endless call into C that never gives the interpreter back."""
    ctypes.PyDLL(None).sleep(600)


def _deadlock() -> None:
    lock = threading.Lock()
    lock.acquire()
    lock.acquire()


def _raise(error: Exception) -> None:
    raise error


FAULTS = {
    "kill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "segfault": lambda: ctypes.string_at(0),
    "exit": lambda: os._exit(7),
    "hold": _hold_everything,
    "deadlock": _deadlock,
    "leave": lambda: sys.exit(0),
    "fail": lambda: _raise(ValueError("it was told to fail")),
    "lose": lambda: _raise(OSError("the surroundings fail")),
    "refuse": lambda: _raise(UserError("put this right first")),
    "full": lambda: _raise(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))),
}
