"""A simulator in a worker process: the same values, errors that travel, deaths that are told, nothing left behind."""

import copy
import gc
import os
import pickle
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from sumo_env.config import ConfigError
from sumo_env.simulator import SimulatorError
from sumo_env.sumo import process
from sumo_env.sumo.process import SimulatorDied, SumoProcess
from tests.processes import descriptors, ends, is_alive, started
from tests.sumo_env.sumo.fake import (
    COMMAND,
    CONFIG_ERROR,
    CRASHES_AT_RESET,
    FAKE,
    FOREIGN_ERROR,
    HANGS,
    PRINTS,
    open_simulator,
    scenario,
)


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    """No file descriptors, once a test and its simulators are over."""
    gc.collect()
    before = descriptors()
    yield
    gc.collect()
    assert descriptors() == before


@pytest.fixture(scope="module")
def source() -> Iterator[SumoProcess]:
    """One that was started, which takes half a second; others are forked from it."""
    with closing(SumoProcess(FAKE)) as simulator:
        simulator.reset(scenario())
        yield simulator


@pytest.fixture
def simulator(source: SumoProcess) -> Iterator[SumoProcess]:
    with closing(copy.deepcopy(source)) as simulator:
        yield simulator


# -- from its start to its end, by each way to a worker ----------------------------------------------------


@pytest.fixture(params=["started", "forked"])
def begun(request: pytest.FixtureRequest, source: SumoProcess) -> Iterator[SumoProcess]:
    """A worker of each kind, one step into episode 7 of the fake simulator."""
    with closing(SumoProcess(FAKE)) as fresh:
        one = source if request.param == "forked" else fresh
        assert len(one.reset(scenario(7, others=50_000))) == 50_001  # a large message
        step = one.step({"ego": COMMAND}, trace=True)
        assert len(step.trace) == 3 and len(step.trace[2]) == 50_001
        with closing(copy.deepcopy(one) if one is source else one) as worker:
            yield worker


SIGNALS = {signal.SIGKILL: "SIGKILL", signal.SIGRTMIN + 1: f"signal {signal.SIGRTMIN + 1}"}


@pytest.mark.parametrize("number", SIGNALS)
def test_a_killed_worker_is_told_and_replaced(begun: SumoProcess, number: int) -> None:
    old = begun.pid
    os.kill(old, number)
    # who has forked it cannot ask the system how it ended
    with pytest.raises(SimulatorDied, match=rf"({SIGNALS[number]}|is gone) .*step 2: .*highway .*seed 7"):
        begun.step({"ego": COMMAND})
    with pytest.raises(SimulatorDied, match="has ended; call reset"):
        begun.step({"ego": COMMAND})
    begun.reset(scenario(8))
    assert begun.pid != old and begun.step({"ego": COMMAND}).scene.time == 1.0


def test_another_sumo_is_warned_about(monkeypatch: pytest.MonkeyPatch) -> None:
    process._check_version.cache_clear()
    monkeypatch.setattr(process, "version", lambda _: "1.27.1")
    with pytest.warns(UserWarning, match=r"libsumo 1.27.1 is not that of the drivers"):
        SumoProcess(FAKE)
    SumoProcess(FAKE)  # once


def test_a_destructor_may_come_after_the_interpreter_s_exit() -> None:
    """As those of gymnasium's vector environments do: what is forgotten then is not ended again."""
    for simulator in (SumoProcess(FAKE), SumoProcess(FAKE)):  # in this process if it is free, and in a worker
        simulator.reset(scenario())
        simulator._forgotten()
        simulator.close()


def test_a_forgotten_simulator_ends_its_worker() -> None:
    simulator = SumoProcess(FAKE)
    with pytest.raises(RuntimeError, match=r"call reset\(\)"):
        simulator.step({"ego": COMMAND})
    simulator.reset(scenario())
    pid = simulator.pid
    with pytest.raises(TypeError, match=r"copy\.deepcopy"):
        pickle.dumps(simulator)
    del simulator
    gc.collect()
    assert ends(pid)


# -- what a simulator says ---------------------------------------------------------------------------------


def test_what_the_simulator_prints_does_not_disturb(capfd) -> None:
    with closing(SumoProcess(FAKE)) as simulator:
        simulator.reset(scenario(PRINTS))
        assert simulator.step({"ego": COMMAND}).ego.distance == COMMAND.target_speed
    assert capfd.readouterr() == ("SUMO says something\nand so does C++\n", "")


@pytest.mark.parametrize(
    ("seed", "error", "message"),
    [
        (CONFIG_ERROR, ConfigError, "a key that is not known"),
        (FOREIGN_ERROR, SimulatorError, "ForeignError: 1 and 2"),  # of a class that cannot be pickled
    ],
)
def test_an_error_is_told_with_its_place_and_the_worker_goes_on(simulator, seed, error, message) -> None:
    simulator.reset(scenario(seed))
    pid = simulator.pid
    with pytest.raises(error, match=message) as caught:
        simulator.step({"ego": COMMAND})
    assert "fake.py" in caught.value.__notes__[0]
    simulator.reset(scenario())
    assert simulator.pid == pid


@pytest.mark.parametrize(
    ("program", "seed", "error", "message"),
    [
        ("tests.sumo_env.sumo.fake:NoSuchSimulator", 0, AttributeError, "NoSuchSimulator"),
        (FAKE, CRASHES_AT_RESET, SimulatorDied, f"SIGSEGV: the reset of .* seed {CRASHES_AT_RESET}"),
    ],
)
def test_what_goes_wrong_at_a_reset_is_its_error(program, seed, error, message) -> None:
    with closing(SumoProcess(program)) as simulator, pytest.raises(error, match=message):
        simulator.reset(scenario(seed))


# -- silence and interrupts --------------------------------------------------------------------------------


def test_a_silent_worker_is_killed() -> None:
    with closing(SumoProcess(FAKE)) as simulator:
        simulator.reset(scenario(HANGS))
        pid = simulator.pid
        simulator.timeout = 0.2  # [s]
        with pytest.raises(SimulatorDied, match=r"gave no answer for 0\.2 s in step 1"):
            simulator.step({"ego": COMMAND})
        assert not is_alive(pid)


REQUESTS: dict[str, tuple[Any, Callable[[SumoProcess], Any]]] = {
    "recv_into": (socket.socket, lambda simulator: simulator.step({"ego": COMMAND})),
    "recv_fds": (socket, copy.deepcopy),
}


@pytest.mark.parametrize("reading", REQUESTS)
def test_an_interrupted_request_ends_the_episode(simulator, monkeypatch, reading: str) -> None:
    """Its answer, which is still to come, must not be taken for that to the next request."""

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    module, call = REQUESTS[reading]
    simulator.reset(scenario(3))
    pid = simulator.pid
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(module, reading, interrupted)
        call(simulator)
    assert ends(pid)
    with pytest.raises(SimulatorDied, match="has ended; call reset"):
        simulator.step({"ego": COMMAND})
    assert simulator.reset(scenario()).time == 0.0


# -- threads and forks -------------------------------------------------------------------------------------


def test_threads_get_the_answers_to_their_own_requests(simulator: SumoProcess) -> None:
    simulator.reset(scenario())
    paths = ["vehicle.getSpeed", "vehicle.setSpeed"]

    def ask(path: str) -> set[str]:
        return {simulator.call(path, (), {}) for _ in range(200)}

    with ThreadPoolExecutor(2) as pool:
        assert list(pool.map(ask, paths)) == [{path} for path in paths]
    # a copy does again what may have changed something
    assert [name for name, _ in simulator._calls] == ["reset", *["call"] * 200]
    assert {arguments[0] for _, arguments in simulator._calls[1:]} == {"vehicle.setSpeed"}


def test_a_fork_while_a_thread_waits_for_an_answer(simulator: SumoProcess) -> None:
    """The child, in which the thread is not, begins an episode of its own."""
    simulator.reset(scenario(HANGS))
    worker = simulator.pid
    with ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(simulator.step, {"ego": COMMAND})
        while simulator._lock.acquire(blocking=False):
            simulator._lock.release()
        time.sleep(0.05)  # until it has asked
        child = os.fork()
        if not child:
            try:
                os._exit(round(simulator.reset(scenario(1)).x[-1]))
            finally:
                os._exit(9)
        assert ends(child)
        os.kill(worker, signal.SIGKILL)
        assert isinstance(waiting.exception(), SimulatorDied)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 1


# -- the end of workers ------------------------------------------------------------------------------------


def run(tmp_path: Path, script: str) -> subprocess.Popen[str]:
    """A script of a user: not guarded by anything."""
    file = tmp_path / "script.py"
    file.write_text(
        "import os, sys, time\n"
        "from tests.sumo_env.sumo.fake import *\n"
        "simulators = [open_simulator() for _ in range(3)]\n"
        "for seed, simulator in enumerate(simulators):\n"
        "    simulator.reset(scenario(seed))\n"
        "    simulator.step({'ego': COMMAND})\n"
        "print(*[one.pid for one in simulators[1:]], flush=True)\n" + script
    )
    return started(file, TMPDIR=str(tmp_path))


def pids(script: subprocess.Popen[str]) -> list[int]:
    """Process ids of its workers, which it prints first."""
    return [int(pid) for pid in script.stdout.readline().split()]


@pytest.mark.parametrize("end", ["", "1 / 0", "os.kill(os.getpid(), 9)"])
def test_workers_end_with_their_parent(tmp_path: Path, end: str) -> None:
    script = run(tmp_path, end)
    workers = pids(script)
    script.communicate(timeout=60)
    assert len(workers) == 2
    assert all(ends(pid) for pid in workers)


def test_ctrl_c_in_the_terminal_ends_the_script_alone(tmp_path: Path) -> None:
    """It is sent to the whole foreground process group; workers neither print anything nor stay."""
    script = run(
        tmp_path,
        "try:\n    print('in try', flush=True)\n"
        "    more = [open_simulator() for _ in range(60)]\n    for one in more: one.reset(scenario())\n"
        "except KeyboardInterrupt:\n    print('stopped')\n",
    )
    workers = pids(script)
    script.stdout.readline()  # only now is the script where it catches the interrupt
    time.sleep(0.3)
    os.killpg(script.pid, signal.SIGINT)
    out, errors = script.communicate(timeout=60)
    assert (out, errors, script.returncode) == ("stopped\n", "", 0)
    assert all(ends(pid) for pid in workers)


# -- who has the simulation of this process ----------------------------------------------------------------


def test_the_first_is_in_this_process_and_further_ones_are_not() -> None:
    first, second, third = (open_simulator() for _ in range(3))
    for seed, simulator in enumerate((second, first, third)):  # the order of resets counts
        simulator.reset(scenario(seed))
    assert [one.pid is None for one in (first, second, third)] == [False, True, False]
    assert {one.step({"ego": COMMAND}).scene.x[-1] for one in (second, first, third)} == {0.0, 1.0, 2.0}


def test_closing_or_forgetting_the_first_frees_it() -> None:
    first, second, third = (open_simulator() for _ in range(3))
    first.reset(scenario())
    first.close()
    second.reset(scenario())
    first.reset(scenario())  # used again after all
    assert second.pid is None
    assert first.pid is not None
    del second
    gc.collect()
    first.reset(scenario())
    assert first.pid is not None  # stays where it is
    third.reset(scenario())
    assert third.pid is None


def test_threads_do_not_share_it() -> None:
    simulators = [open_simulator() for _ in range(4)]
    barrier = threading.Barrier(len(simulators))

    def reset(index: int) -> None:
        barrier.wait()
        simulators[index].reset(scenario(index))

    with ThreadPoolExecutor(len(simulators)) as pool:
        list(pool.map(reset, range(len(simulators))))
    assert sum(one.pid is None for one in simulators) == 1
    for index, one in enumerate(simulators):
        assert one.step({"ego": COMMAND}).scene.x[-1] == index


def test_a_forked_process_has_its_own_workers(tmp_path: Path) -> None:
    """It inherits the simulation and the connections of its parent, and may disturb neither."""
    script = run(
        tmp_path,
        "child = os.fork()\n"
        "if child == 0:\n"
        "    try:\n        simulators[1].step({'ego': COMMAND})\n"
        "    except RuntimeError as error:\n        print(error)\n"
        "    simulators[1].reset(scenario(40))\n"
        "    one = open_simulator()\n"
        "    one.reset(scenario(50))\n"
        "    print(simulators[1].step({'ego': COMMAND}).scene.x[-1], one.step({'ego': COMMAND}).scene.x[-1])\n"
        "    print('here' if one.pid is None else 'in a worker')\n"
        "else:\n"
        "    print(os.waitpid(child, 0)[1])\n"
        "    print([one.step({'ego': COMMAND}).scene.time for one in simulators])\n",
    )
    workers = pids(script)
    with script:
        refusal, values, kind, status, times = script.stdout.read().splitlines()
        assert script.stderr.read() == ""
    assert "belongs to the process that this one was forked from" in refusal
    assert (values, kind) == ("40.0 50.0", "in a worker")
    assert (status, times) == ("0", "[2.0, 2.0, 2.0]")
    assert all(ends(pid) for pid in workers)
