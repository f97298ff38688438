"""A simulator in a worker process, behind the same `Simulator` protocol.

The worker is ``python -m sumo_env.sumo.worker``, not a process of multiprocessing, which would import the user's script
once more: nothing has to be guarded by ``if __name__ == "__main__"``. Requests and answers are pickles on a socket of
their own, so that nothing that SUMO prints gets between them. The worker ends when the socket is closed, by this
process or by its death.
"""

from __future__ import annotations

import os
import pickle
import select
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import weakref
from collections.abc import Callable
from contextlib import suppress
from typing import Any, NoReturn, TypeVar

from sumo_env.scene import Scene
from sumo_env.simulator import EgoCommand, SimulatorError, Step, refuse_to_pickle
from sumo_env.sumo.options import check_copyable
from sumo_env.traffic.scenario import Scenario

SIMULATOR = "sumo_env.sumo.world:SumoSimulator"  # what a worker runs, and the first environment of a process
TIMEOUT = 300.0  # [s] for an answer; a step takes milliseconds, the start of a worker less than a second
ATTEMPTS = 3  # to begin an episode in new workers, before giving up
GRACE = 5.0  # [s] for a worker to end by itself
SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


CAN_FORK = hasattr(os, "fork") and hasattr(socket, "send_fds")  # else a copy is driven again from the start
T = TypeVar("T")


class SimulatorDied(SimulatorError):
    """The worker process that drove an episode is gone, and the episode with it; `reset` begins another one."""


class Uncopied(SimulatorError):
    """The worker goes on, but the system gave it no process for a copy."""


class RemoteSimulator:
    """A `Simulator` in a worker process, which is started at the first `reset`.

    A worker that is dead or that does not answer is replaced at the next `reset`; a `step` that meets it raises
    `SimulatorDied`, which says what episode has ended. Exceptions of the simulator are raised here as well, with
    their class if it is one of Python's, gymnasium's or this package's, else as a `SimulatorError` that names it.

    Args:
        simulator: class that the worker is to run, as ``module:name``.
        timeout: longest time to wait for an answer [s].
        options: of SUMO.
    """

    def __init__(
        self, simulator: str = SIMULATOR, timeout: float = TIMEOUT, options: tuple[str, ...] = ()
    ) -> None:
        self.timeout = timeout
        self._name, self._options = simulator, options
        self._worker: _Worker | None = None
        self._episode = ""  # for error messages
        self._calls: list[tuple[str, tuple[Any, ...]]] = []  # what the episode was made of, from its reset on

    @property
    def pid(self) -> int | None:
        """Process id of the worker, None without one."""
        return None if self._worker is None else self._worker.process.pid

    def reset(self, scenario: Scenario) -> Scene:
        """Place a scenario, in a new worker if there is none or if it has died.

        Raises:
            SimulatorDied: workers died again and again.
        """
        for _ in range(ATTEMPTS):
            if self._worker is None:
                self._adopt(_Worker.start(self._name, self._options))
            self._episode = f"the reset of {scenario.task} (scenario seed {scenario.seed})"
            self._calls.clear()
            try:
                scene: Scene = self._ask("reset", scenario)
            except SimulatorDied as error:
                died = error
            else:
                self._episode = (
                    f"an episode of {scenario.task} (scenario seed {scenario.seed}, risk {scenario.risk:g})"
                )
                return scene
        raise SimulatorDied(
            f"{ATTEMPTS} workers died one after another, the last one so: {died}. What they said is above, if they "
            "did; `python -m sumo_env.doctor` checks the installation"
        )

    def step(self, command: EgoCommand, trace: bool = False) -> Step:
        """Drive one policy step.

        Raises:
            SimulatorDied: the worker has died, or has not answered in time.
        """
        step: Step = self._ask("step", command, trace)
        return step

    def imagine(self, scenario: Scenario) -> None:
        """See `Simulator.imagine`."""
        self._ask("imagine", scenario)

    def clone(self) -> RemoteSimulator:
        """A simulator in the same state: the worker forks; where there is no fork, the episode is driven again.

        Raises:
            TypeError: an option of SUMO forbids it (`options.check_copyable`).
            SimulatorDied: the worker has died.
        """
        check_copyable(self._options)
        twin = RemoteSimulator(self._name, self.timeout, self._options)
        if self._worker is None and not self._episode:
            return twin  # there is no episode
        if self._worker is not None and not CAN_FORK:
            twin.drive_again(self._calls)
            return twin
        twin._adopt(self._talk(lambda worker: worker.fork(self.timeout)))
        twin._episode, twin._calls = self._episode, self._calls.copy()
        return twin

    def drive_again(self, calls: list[tuple[str, tuple[Any, ...]]]) -> Any:
        """Drive an episode once more, from its reset on; returns the value of the last call."""
        value = None
        for command, arguments in calls:
            value = getattr(self, command)(*arguments)
        return value

    def __deepcopy__(self, memo: dict[int, Any]) -> RemoteSimulator:
        return self.clone()

    def close(self) -> None:
        """End the worker."""
        self._episode = ""
        self._end()

    def __reduce__(self) -> NoReturn:
        refuse_to_pickle()

    def _adopt(self, worker: _Worker) -> None:
        self._worker = worker
        self._forgotten = weakref.finalize(self, worker.end)  # as garbage, or at the interpreter's exit

    def _end(self, grace: float = GRACE) -> None:
        if self._worker is not None:
            self._forgotten.detach()
            self._worker.end(grace)
            self._worker = None

    def _ask(self, command: str, *arguments: Any) -> Any:
        self._calls.append((command, arguments))
        request = pickle.dumps((command, arguments), 5)
        error, value = self._talk(lambda worker: worker.exchange(request, self.timeout))
        if error is not None:
            raise error
        return value

    def _talk(self, exchange: Callable[[_Worker], T]) -> T:
        if self._worker is None:
            if self._episode:
                raise SimulatorDied(f"{self._episode} has ended; call reset()")
            raise RuntimeError("call reset() before step()")
        try:
            return exchange(self._worker)
        except Uncopied:
            raise
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            how = self._worker.death(error)
            self._end(grace=0.0)
            steps = sum(command == "step" for command, _ in self._calls)
            when = f" in step {steps}" if steps else ""
            raise SimulatorDied(
                f"the worker process of SUMO {how}{when}: {self._episode} has ended; reset() begins another one in "
                "a new worker"
            ) from None
        except BaseException:
            # Ctrl-C: the answer is still to come, and would be taken for that to the next request
            self._end(grace=0.0)
            raise


class _Worker:
    """A process, and the socket to talk with it."""

    def __init__(self, process: subprocess.Popen[bytes] | _Copy, link: socket.socket, folder: str) -> None:
        self._owner, self.process, self._folder = os.getpid(), process, folder
        self._socket, self._stream = link, link.makefile("rwb")
        _workers.add(self)

    @classmethod
    def start(cls, simulator: str, options: tuple[str, ...]) -> _Worker:
        """A new process."""
        folder = tempfile.mkdtemp(prefix="sumo_env-")  # for its files, which outlive it if it is killed
        ours, theirs = socket.socketpair()
        # -P, and the search path of this process: the worker imports what this process would import
        path = os.pathsep.join(folder or os.getcwd() for folder in sys.path)
        process = subprocess.Popen(
            [
                sys.executable,
                "-P",
                "-m",
                "sumo_env.sumo.worker",
                str(theirs.fileno()),
                simulator,
                folder,
                *options,
            ],
            env={**os.environ, **SINGLE_THREAD, "PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            pass_fds=(theirs.fileno(),),
            start_new_session=True,  # Ctrl-C in the terminal is for this process alone
        )
        theirs.close()  # so that reading ends when the worker does
        return cls(process, ours, folder)

    def fork(self, timeout: float) -> _Worker:
        """A copy of the process, which serves a socket of its own."""
        folder = tempfile.mkdtemp(prefix="sumo_env-")
        ours, theirs = socket.socketpair()
        try:
            self._socket.settimeout(timeout)
            self._stream.write(pickle.dumps(("fork", (folder,)), 5))
            self._stream.flush()
            if self._stream.read(1) != b".":
                raise EOFError("no answer to a request for a copy")
            socket.send_fds(self._socket, [b"."], [theirs.fileno()])
            error, pid = pickle.load(self._stream)
            if error is not None:
                raise Uncopied(f"the worker process of SUMO cannot be copied now: {error}")
            return _Worker(_Copy(pid), ours, folder)
        except BaseException:
            ours.close()
            shutil.rmtree(folder, ignore_errors=True)
            raise
        finally:
            theirs.close()

    def exchange(self, request: bytes, timeout: float) -> Any:
        """The answer to a request."""
        self._socket.settimeout(timeout)
        self._stream.write(request)
        self._stream.flush()
        return pickle.load(self._stream)

    def death(self, error: Exception) -> str:
        """How the worker has ended, given the error that `exchange` has met."""
        if self._owner != os.getpid():
            return "belongs to the process that this one was forked from"
        if isinstance(error, TimeoutError):
            return f"gave no answer for {self._socket.gettimeout():g} s"
        if isinstance(self.process, _Copy):
            return "is gone (it was a copy: how it ended is not known)"
        with suppress(subprocess.TimeoutExpired):
            code = self.process.wait(GRACE)
            if code < 0:
                return f"was killed by {signal.Signals(-code).name}"
            return f"ended with exit code {code}"
        return f"closed its connection ({error})"

    def end(self, grace: float = GRACE) -> None:
        """See to it that the worker is gone, after `grace` [s] to end by itself, and what it has left."""
        self.disconnect()
        if self._owner != os.getpid():
            return
        try:
            self.process.wait(grace)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def disconnect(self) -> None:
        """Close the socket, which tells the worker to end."""
        descriptor = self._socket.detach()  # unlike close(), does not flush half a request
        if descriptor >= 0:
            os.close(descriptor)


class _Copy:
    """A process that a worker has forked: the part of `subprocess.Popen` that is needed here."""

    def __init__(self, pid: int) -> None:
        self.pid, self._handle = pid, -1
        if hasattr(os, "pidfd_open"):  # not on macOS; a process id alone may be another process's by now
            with suppress(ProcessLookupError):
                self._handle = os.pidfd_open(pid)

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; how it ended is known to nobody."""
        if self._handle >= 0:
            if not select.select([self._handle], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired("a copy of a worker", timeout or 0.0)
            os.close(self._handle)
            self._handle = -1
        return 0

    def kill(self) -> None:
        """Kill it."""
        if self._handle >= 0:
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(self._handle, signal.SIGKILL)


_workers: weakref.WeakSet[_Worker] = weakref.WeakSet()


def _disconnect_all() -> None:
    """In a forked process: the workers are the parent's, and end when the last of these sockets is closed."""
    for worker in _workers:
        worker.disconnect()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disconnect_all)
