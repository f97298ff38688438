"""A simulator in a worker process: the same values, errors that travel, deaths that are told, nothing left behind."""

from __future__ import annotations

import gc
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from sumo_env.config import ConfigError
from sumo_env.simulator import SimulatorError
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


@pytest.fixture
def simulator() -> Iterator[SumoProcess]:
    simulator = SumoProcess(FAKE)
    yield simulator
    simulator.close()


# -- the protocol ------------------------------------------------------------------------------------------


def test_large_messages_travel(simulator: SumoProcess) -> None:
    assert len(simulator.reset(scenario(others=50_000))) == 50_001
    step = simulator.step({"ego": COMMAND}, trace=True)
    assert len(step.trace) == 3 and len(step.trace[2]) == 50_001


def test_a_step_needs_a_reset(simulator: SumoProcess) -> None:
    with pytest.raises(RuntimeError, match=r"call reset\(\) before step\(\)"):
        simulator.step({"ego": COMMAND})


def test_what_the_simulator_prints_does_not_disturb(simulator, capfd) -> None:
    simulator.reset(scenario(PRINTS))
    assert simulator.step({"ego": COMMAND}).ego.distance == COMMAND.target_speed
    assert capfd.readouterr() == ("SUMO says something\nand so does C++\n", "")


# -- errors ------------------------------------------------------------------------------------------------


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


def test_a_simulator_that_cannot_be_made_is_an_error_of_the_reset() -> None:
    simulator = SumoProcess("tests.sumo_env.sumo.fake:NoSuchSimulator")
    with pytest.raises(AttributeError, match="NoSuchSimulator"):
        simulator.reset(scenario())


# -- deaths ------------------------------------------------------------------------------------------------


def test_a_killed_worker_is_told_and_replaced(simulator: SumoProcess) -> None:
    simulator.reset(scenario(7))
    simulator.step({"ego": COMMAND})
    old = simulator.pid
    os.kill(old, signal.SIGKILL)
    with pytest.raises(
        SimulatorDied,
        match=r"killed by SIGKILL in step 2: an episode of highway \(scenario seed 7, risk 0.5\)",
    ):
        simulator.step({"ego": COMMAND})
    with pytest.raises(SimulatorDied, match=r"seed 7, risk 0.5\) has ended; call reset"):
        simulator.step({"ego": COMMAND})
    simulator.reset(scenario(8))
    assert simulator.pid != old
    assert simulator.step({"ego": COMMAND}).scene.time == 1.0


def test_a_scenario_that_kills_every_worker_is_an_error(simulator: SumoProcess) -> None:
    with pytest.raises(
        SimulatorDied, match=f"SIGSEGV: the reset of highway .scenario seed {CRASHES_AT_RESET}"
    ):
        simulator.reset(scenario(CRASHES_AT_RESET))


def test_a_silent_worker_is_killed(simulator: SumoProcess) -> None:
    simulator.reset(scenario(HANGS))
    pid = simulator.pid
    simulator.timeout = 0.2  # [s]
    with pytest.raises(SimulatorDied, match=r"gave no answer for 0\.2 s in step 1"):
        simulator.step({"ego": COMMAND})
    assert not is_alive(pid)


def test_an_interrupted_step_ends_the_episode(simulator: SumoProcess) -> None:
    """The answer to it must not be taken for that to the next request."""
    simulator.reset(scenario(HANGS))
    timer = threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        simulator.step({"ego": COMMAND})
    timer.join()
    with pytest.raises(SimulatorDied, match="has ended; call reset"):
        simulator.step({"ego": COMMAND})
    assert simulator.reset(scenario()).time == 0.0


# -- the end of workers ------------------------------------------------------------------------------------


def test_closing_ends_the_worker_and_may_be_repeated(simulator: SumoProcess) -> None:
    simulator.close()
    simulator.reset(scenario())
    pid = simulator.pid
    simulator.close()
    simulator.close()
    assert not is_alive(pid)
    simulator.reset(scenario())  # as a simulator in this process could be


def test_a_forgotten_simulator_ends_its_worker() -> None:
    simulator = SumoProcess(FAKE)
    simulator.reset(scenario())
    pid = simulator.pid
    del simulator
    gc.collect()
    assert not is_alive(pid)


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


def in_this_process(simulator: SumoProcess) -> bool:
    return simulator.pid is None


def test_the_first_is_in_this_process_and_further_ones_are_not() -> None:
    first, second, third = (open_simulator() for _ in range(3))
    for seed, simulator in enumerate((second, first, third)):  # the order of resets counts
        simulator.reset(scenario(seed))
    assert [in_this_process(one) for one in (first, second, third)] == [False, True, False]
    assert {one.step({"ego": COMMAND}).scene.x[-1] for one in (second, first, third)} == {0.0, 1.0, 2.0}


def test_closing_or_forgetting_the_first_frees_it() -> None:
    first, second, third = (open_simulator() for _ in range(3))
    first.reset(scenario())
    first.close()
    second.reset(scenario())
    first.reset(scenario())  # used again after all
    assert in_this_process(second)
    assert not in_this_process(first)
    del second
    gc.collect()
    first.reset(scenario())
    assert not in_this_process(first)  # stays where it is
    third.reset(scenario())
    assert in_this_process(third)


def test_threads_do_not_share_it() -> None:
    simulators = [open_simulator() for _ in range(6)]
    barrier = threading.Barrier(len(simulators))

    def reset(index: int) -> None:
        barrier.wait()
        simulators[index].reset(scenario(index))

    with ThreadPoolExecutor(len(simulators)) as pool:
        list(pool.map(reset, range(len(simulators))))
    assert sum(in_this_process(one) for one in simulators) == 1
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
