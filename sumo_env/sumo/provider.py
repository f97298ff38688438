"""Which process runs SUMO for an environment.

libsumo supports one simulation per process. The first environment of a process has it; every further one gets a
worker process. An environment cannot tell the difference but for the time that a message takes (docs/decisions.md).
"""

from __future__ import annotations

import os
import threading
import weakref
from typing import NoReturn

from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand, Simulator, Step, refuse_to_copy
from sumo_env.sumo.options import make
from sumo_env.sumo.remote import SIMULATOR, RemoteSimulator
from sumo_env.traffic.scenario import Scenario


def open_simulator(simulator: str = SIMULATOR, options: tuple[str, ...] = ()) -> Simulator:
    """SUMO in this process if no other environment has it, else in a worker process.

    simulator: class that is to be run, as ``module:name``; options: of SUMO.

    The choice is made at the first `reset`, so an environment that is only looked at holds nothing. It stands until
    `close`; the reset after it chooses again. Threads may call this at once.
    """
    return _Chosen(simulator, options)


class _Chosen:
    """A simulator that chooses its process at `reset`."""

    def __init__(self, simulator: str, options: tuple[str, ...]) -> None:
        self._name, self._options = simulator, options
        self._simulator: Simulator | None = None

    def reset(self, scenario: Scenario) -> Scene:
        if self._simulator is None:
            local = _slot.claim(self)
            if local:
                self._simulator = make(self._name, self._options)
            else:
                self._simulator = RemoteSimulator(self._name, options=self._options)
        return self._simulator.reset(scenario)

    def step(self, command: EgoCommand, trace: bool = False) -> Step:
        if self._simulator is None:
            raise RuntimeError("call reset() before step()")
        return self._simulator.step(command, trace)

    def close(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None
        _slot.release(self)

    def __reduce__(self) -> NoReturn:
        refuse_to_copy()


class _Slot:
    """The simulation of this process, and who has it.

    The holder is referred to weakly: where it is garbage, the slot is free. A forked process inherits the holder, and
    so its new environments get workers of their own.
    """

    def __init__(self) -> None:
        self.lock = threading.RLock()  # reentrant: garbage collection inside `claim` may close an environment
        self._holder: weakref.ref[object] = weakref.ref(self)  # to itself: free

    def claim(self, claimant: object) -> bool:
        """Make this object the holder, if there is none."""
        with self.lock:
            free = self._holder() in (None, self, claimant)
            if free:
                self._holder = weakref.ref(claimant)
            return free

    def release(self, holder: object) -> None:
        """Make the slot free, if this object holds it."""
        with self.lock:
            if self._holder() is holder:
                self._holder = weakref.ref(self)


_slot = _Slot()


def _unlock() -> None:
    """In a forked process: another thread may have held the lock."""
    _slot.lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_unlock)
