"""Which process runs SUMO for an environment: this one, or a worker behind the same `Simulator` protocol; and copies.

libsumo supports one simulation per process. The first environment of a process has it; every further one gets a worker
process, and cannot tell the difference except by the time that a message takes. A worker is a Python that calls
`sumo_env.sumo.worker.main`, not a process of multiprocessing, which would import the user's script once more. Requests
and answers are pickles on a socket of their own, so that nothing that SUMO prints gets between them. A worker ends when
the socket is closed, by this process or by its death.

An episode is copied by forking its worker. One of this process is first driven again in a worker, to the same bits.
Where a process cannot be forked, every copy is driven again.
"""

import os
import pickle
import signal
import socket
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, ClassVar, NoReturn, TypeVar

import cloudpickle
from gymnasium import logger

from sumo_env.config import warn_once
from sumo_env.scene import Scene, same
from sumo_env.simulator import Commands, SimulatorError, Step, WindowClosed
from sumo_env.sumo import pipe
from sumo_env.sumo.user_options import LIVE, check_copyable
from sumo_env.sumo.worker import make
from sumo_env.traffic.scenario import Scenario

SIMULATOR = "sumo_env.sumo.world:SumoSimulator"
FILE_SIMULATOR = "sumo_env.scenarios.simulator:FileSimulator"  # of scenarios with SUMO's own traffic
TIMEOUT = 300.0  # [s] for an answer; a step takes milliseconds, the start of a worker less than a second
GRACE = 5.0  # [s] for a worker to end by itself
SEVERAL = (
    "this process has several environments on SUMO: calls such as libsumo.vehicle.getSpeed(...) read the first one; "
    "env.unwrapped.sumo.vehicle.getSpeed(...) asks an environment's own SUMO"
)
SUMO_VERSION = "1.28.0"  # that the drivers were calibrated on
SINGLE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
T = TypeVar("T")


class SimulatorDied(SimulatorError):
    """The worker process that drove an episode is gone, and the episode with it; `reset` begins another one."""


class SumoProcess:
    """A `Simulator` in a process that is chosen at the first `reset`, so that one that is only looked at holds nothing.

    A worker that is dead or that does not answer is replaced at the next `reset`; a `step` that meets it raises
    `SimulatorDied`, which says what episode has ended. Exceptions of the simulator are raised here as well, with
    their class if they can be pickled, else as a `SimulatorError` that names it.

    Args:
        simulator: class that is to be run, as ``module:name``; by default the one that a scenario needs.
        options: of SUMO.
        here: whether it may be this process. The choice stands until `close`. Threads may ask at once.
        live: whether a worker runs SUMO in its own window, until the user closes it. Copies have no window.
    """

    timeout: float | None = TIMEOUT  # [s] to wait for an answer of the worker

    def __init__(
        self, simulator: str = "", options: Mapping[str, str] = {}, here: bool = False, live: bool = False
    ) -> None:
        _check_version()
        self._name, self._options, self._may_be_here = simulator, options, here
        self._live = live
        if live:
            self.timeout = None  # the user may hold the simulation
        self._host: _Here | _Worker | None = None
        self._running = ""  # class that runs
        self._episode = ""  # for error messages
        self._calls: list[tuple[str, tuple[Any, ...]]] = []  # what the episode was made of, from its reset on
        self._scene: Scene | None = None
        self._lock = threading.RLock()  # of a request and its answer
        _processes.add(self)

    @property
    def pid(self) -> int | None:
        """Process id of the worker, None without one."""
        return self._host.pid if isinstance(self._host, _Worker) else None

    def reset(self, scenario: Scenario) -> Scene:
        """Place a scenario, in a new worker if there is none or if it has died.

        Raises:
            SimulatorDied: the new worker has died as well.
        """
        with self._lock:
            try:
                return self._begin(scenario)
            except (SimulatorDied, WindowClosed):  # perhaps between two episodes
                return self._begin(scenario)

    def _begin(self, scenario: Scenario) -> Scene:
        name = self._name or (SIMULATOR if scenario.traffic is None else FILE_SIMULATOR)
        if self._host is not None and name != self._running:
            self._end()
        self._running = name
        if self._host is None:
            here = self._may_be_here and not self._live and _Here.take(name, self._options)
            if self._may_be_here and not self._live and not here and name == FILE_SIMULATOR:
                with suppress(UserWarning):  # where a filter makes errors of warnings
                    warn_once(SEVERAL)
            options = {LIVE: "true", **self._options} if self._live else self._options
            self._adopt(here or _Worker.start(name, options))
        self._calls = []
        self._episode = f"the reset of {scenario.task} (scenario seed {scenario.seed})"
        self._scene = scene = self._ask("reset", scenario)
        self._episode = (
            f"an episode of {scenario.task} (scenario seed {scenario.seed}, risk {scenario.risk:g})"
        )
        return scene

    def step(self, commands: Commands, trace: bool = False) -> Step:
        """Drive one policy step.

        Raises:
            SimulatorDied: the worker has died, or has not answered in time.
        """
        with self._lock:
            step: Step = self._ask("step", commands, trace)
            self._scene = step.scene
            return step

    def imagine(self, scenario: Scenario) -> None:
        """See `Simulator.imagine`."""
        with self._lock:
            self._ask("imagine", scenario)

    def call(self, path: str, arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        """A function of libsumo, such as ``vehicle.getSpeed``, in the simulation of this simulator."""
        with self._lock:
            value = self._ask("call", path, arguments, named)
            if path.rpartition(".")[2].startswith("get"):
                self._calls.pop()  # a copy need not ask again
            return value

    def __deepcopy__(self, memo: dict[int, Any]) -> "SumoProcess":
        """A simulator in the same state.

        Raises:
            TypeError: an option of SUMO forbids it (`user_options.check_copyable`).
            SimulatorDied: the worker has died.
            SimulatorError: somebody else has changed the simulation, or the system has no process for the copy.
        """
        check_copyable(self._options)
        twin = SumoProcess(self._name, self._options)
        with self._lock:
            if self._episode:
                self._copy_into(twin)
        twin._may_be_here = self._may_be_here
        return twin

    def _copy_into(self, twin: "SumoProcess") -> None:
        forks = pipe.FORKS and not self._live
        if isinstance(self._talk(lambda host: host), _Here) and forks:  # go on in a worker
            there = self._driven_again()
            self._end()
            self._adopt(there)
        if forks:
            twin._adopt(self._talk(lambda host: host.fork(self.timeout)))
        else:
            twin._adopt(self._driven_again())
        twin._running = self._running
        twin._episode, twin._calls, twin._scene = self._episode, self._calls.copy(), self._scene

    def close(self) -> None:
        """Close the simulator, and end the worker."""
        self._episode = ""
        self._end()

    def __reduce__(self) -> NoReturn:
        raise TypeError("SUMO's environments cannot be pickled: copy.deepcopy(env) makes a copy")

    def _adopt(self, host: "_Here | _Worker") -> None:
        self._host = host
        self._forgotten = weakref.finalize(self, host.forget)  # as garbage, or at the interpreter's exit

    def _end(self, grace: float = GRACE) -> None:
        if self._host is not None:
            # else the interpreter's exit has seen to it before a destructor comes
            if self._forgotten.detach():
                self._host.end(grace)
            self._host = None

    def _driven_again(self) -> "_Worker":
        """A new worker in which the episode has been driven again up to here."""
        there = SumoProcess(self._name, self._options)
        try:
            for command, arguments in self._calls:
                getattr(there, command)(*arguments)
            if not same(there._scene, self._scene):
                raise SimulatorError("driven again, this episode is another: was it changed through libsumo?")
        except BaseException:
            there.close()
            raise
        assert isinstance(there._host, _Worker)
        there._forgotten.detach()
        return there._host

    def _ask(self, command: str, *arguments: Any) -> Any:
        error, value = self._talk(lambda host: host.exchange(command, arguments, self.timeout), command)
        if isinstance(error, WindowClosed):
            logger.warn("%s, and the next ones have no window", error)  # what it says may have a %
            self._live = False
            self._end()
        if error is not None:
            raise error
        self._calls.append((command, arguments))
        return value

    def _talk(self, exchange: Callable[[Any], T], command: str = "") -> T:
        if self._host is None:
            if self._episode:
                raise SimulatorDied(f"{self._episode} has ended; call reset()")
            raise RuntimeError("call reset() before step()")
        try:
            return exchange(self._host)
        except SimulatorError:
            raise
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            assert isinstance(self._host, _Worker)
            how = self._host.death(error)
            self._end(grace=0.0)
            steps = 1 + sum(name == "step" for name, _ in self._calls)
            when = f" in step {steps}" if command == "step" else ""
            told = f"the worker process of SUMO {how}{when}: {self._episode} has ended; call reset()"
            raise SimulatorDied(told) from None
        except BaseException:
            # Ctrl-C: the answer is still to come, and would be taken for that to the next request
            self._end(grace=0.0)
            raise


@cache
def _check_version() -> None:
    """Warn, once in a process, of another SUMO than that of the drivers, which pip would not install."""
    with suppress(PackageNotFoundError):
        if (found := version("libsumo")) != SUMO_VERSION:
            warn_once(
                f"libsumo {found} is not that of the drivers, which may drive otherwise: pip install "
                f"libsumo=={SUMO_VERSION}"
            )


class _Here:
    """The simulation of this process, which one at a time may take."""

    _taken: ClassVar = threading.Lock()

    def __init__(self, simulator: Any) -> None:
        self._simulator = simulator

    @classmethod
    def take(cls, simulator: str, options: Mapping[str, str]) -> "_Here | None":
        """The simulation if it is free."""
        if not cls._taken.acquire(blocking=False):
            return None
        try:
            return cls(make(simulator, options))
        except BaseException:
            cls._taken.release()
            raise

    def exchange(self, command: str, arguments: tuple[Any, ...], timeout: float | None) -> Any:
        """As of `_Worker`."""
        try:
            return None, getattr(self._simulator, command)(*arguments)
        except Exception as error:
            return error, None

    def end(self, grace: float) -> None:
        """Close the simulation, which is free then."""
        self._simulator.close()
        self.forget()

    def forget(self) -> None:
        """Leave the simulation to others as it is."""
        self._taken.release()


class _Worker:
    """A process, and the socket to talk with it. The process has the only other end, so both end together."""

    def __init__(self, pid: int, ours: socket.socket, child: subprocess.Popen[bytes] | None = None) -> None:
        self.pid, self._child = pid, child  # a copy is a child of the worker that has made it
        self._owner = os.getpid()
        self._socket = ours

    @classmethod
    def start(cls, simulator: str, options: Mapping[str, str]) -> "_Worker":
        """A new process."""
        # The worker imports what this process would import. PYTHONPATH cannot have a colon in a name.
        path = [entry for entry in sys.path if isinstance(entry, str)]  # Python skips others
        begin = f"import sys; sys.path[:] = {path!r}; from sumo_env.sumo.worker import main; main()"
        program = [pipe.interpreter(), "-c", begin]
        arguments = [simulator, *(f"{name}={value}" for name, value in options.items())]
        child, ours = pipe.start(program, arguments, {**os.environ, **SINGLE_THREAD})
        return cls(child.pid, ours, child)

    def fork(self, timeout: float | None) -> "_Worker":
        """A copy of the process, which serves a socket of its own; SimulatorError if the system has no process left."""
        self._send("fork", (), timeout)
        answer, descriptors, _, _ = socket.recv_fds(self._socket, 4096, 1)
        if not answer:
            raise EOFError("no answer to a request for a copy")
        error, pid = pickle.loads(answer)
        if error is not None:
            raise SimulatorError(f"the worker process of SUMO cannot be copied now: {error}")
        return _Worker(pid, socket.socket(fileno=descriptors[0]))

    def exchange(self, command: str, arguments: tuple[Any, ...], timeout: float | None) -> Any:
        """The answer to a request: an exception or None, and a value."""
        self._send(command, arguments, timeout)
        return pipe.receive(self._socket)

    def _send(self, command: str, arguments: tuple[Any, ...], timeout: float | None) -> None:
        self._socket.settimeout(timeout)
        # kinds of events may be classes of the user's script, which the worker does not import
        pipe.send(self._socket, cloudpickle.dumps((command, arguments), 5))

    def death(self, error: Exception) -> str:
        """How the worker has ended, given the error that `exchange` has met."""
        if self._owner != os.getpid():
            return "belongs to the process that this one was forked from"
        if isinstance(error, TimeoutError):
            return f"gave no answer for {self._socket.gettimeout():g} s"
        if self._child is None:
            return "is gone (it was a copy)"
        try:
            code = self._child.wait(GRACE)
        except subprocess.TimeoutExpired:
            return f"closed its connection ({error})"
        killer = next((one.name for one in signal.Signals if one == -code), f"signal {-code}")
        return f"was killed by {killer}" if code < 0 else f"ended with exit code {code}"

    def end(self, grace: float = GRACE) -> None:
        """See to it that the worker is gone, after `grace` [s] to end by itself."""
        if self._owner == os.getpid():
            with suppress(OSError):
                self._socket.shutdown(socket.SHUT_WR)  # tells the worker to end
            if not self._is_gone(grace):
                if self._child is not None:
                    self._child.kill()
                else:
                    os.kill(self.pid, signal.SIGKILL)
                self._is_gone(GRACE)
            if self._child is not None:
                self._child.wait()
        self._socket.close()

    forget = end

    def _is_gone(self, within: float) -> bool:
        """Whether the worker closes its end of the socket, as at its death, in this time [s]."""
        self._socket.settimeout(within)
        try:
            while self._socket.recv(65536):
                pass
        except (TimeoutError, BlockingIOError):
            return False
        except OSError:
            pass
        return True


_processes: weakref.WeakSet[SumoProcess] = weakref.WeakSet()


def _disconnect_all() -> None:
    """In a forked process: the workers are the parent's, and end when the last of these sockets is closed.

    So are the threads that may hold a lock.
    """
    for process in _processes:
        process._lock = threading.RLock()
        if isinstance(process._host, _Worker):
            process._host._socket.close()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_disconnect_all)
