"""Which process runs SUMO for an environment.

libsumo supports one simulation per process. The first environment of a process has it; every further one gets a
worker process. An environment cannot tell the difference, except by the time that a message takes.
"""

from __future__ import annotations

import os
import threading
import weakref
from typing import Any, NoReturn

import numpy as np

from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand, Simulator, SimulatorError, Step, refuse_to_pickle
from sumo_env.sumo.options import check_copyable, make
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
        self._calls: list[
            tuple[str, tuple[Any, ...]]
        ] = []  # of the episode, while it is driven in this process
        self._scene: Scene | None = None

    def reset(self, scenario: Scenario) -> Scene:
        self._calls = []
        if self._simulator is None:
            local = _slot.claim(self)
            if local:
                self._simulator = make(self._name, self._options)
            else:
                self._simulator = RemoteSimulator(self._name, options=self._options)
        self._scene = self._simulator.reset(scenario)
        self._calls.append(("reset", (scenario,)))
        return self._scene

    def step(self, command: EgoCommand, trace: bool = False) -> Step:
        if self._simulator is None:
            raise RuntimeError("call reset() before step()")
        step = self._simulator.step(command, trace)
        self._calls.append(("step", (command,)))
        self._scene = step.scene
        return step

    def imagine(self, scenario: Scenario) -> None:
        if self._simulator is None:
            raise RuntimeError("call reset() before imagine()")
        self._simulator.imagine(scenario)
        self._calls.append(("imagine", (scenario,)))

    def clone(self) -> _Chosen:
        """A copy in the same state. A simulation of this process is moved to a worker first, which can fork."""
        check_copyable(self._options)
        twin = _Chosen(self._name, self._options)
        if self._simulator is not None and self._calls:
            if not isinstance(self._simulator, RemoteSimulator):
                self._move_out()
            twin._simulator = self._simulator.clone()
            twin._calls, twin._scene = self._calls.copy(), self._scene
        return twin

    def _move_out(self) -> None:
        """Go on in a worker, where the episode is driven again up to here."""
        worker = RemoteSimulator(self._name, options=self._options)
        try:
            last = worker.drive_again(self._calls)
            scene = last.scene if isinstance(last, Step) else last
            if scene is not None and not _equal(scene, self._scene):
                raise SimulatorError(
                    "this simulation cannot be copied: driven again from its scenario, the episode is another one. "
                    "Was it changed through libsumo?"
                )
        except BaseException:
            worker.close()
            raise
        assert self._simulator is not None
        self._simulator.close()
        _slot.release(self)
        self._simulator = worker

    def __deepcopy__(self, memo: dict[int, object]) -> _Chosen:
        return self.clone()

    def close(self) -> None:
        if self._simulator is not None:
            self._simulator.close()
            self._simulator = None
        _slot.release(self)

    def __reduce__(self) -> NoReturn:
        refuse_to_pickle()


def _equal(one: Scene, other: Scene | None) -> bool:
    """Whether two scenes are the same to the last bit."""
    arrays = ("x", "y", "speed", "heading", "crashed")
    return (
        other is not None
        and one.ids == other.ids
        and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in arrays)
    )


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
