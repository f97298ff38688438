"""No worker outlives the command that started it, however that one ends and whatever the worker is doing."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from experiments.study.compute.executors import local
from tests.processes import children, is_alive, python, started, wait_for

# Workers in a call into C that never gives the interpreter back, as in a compiler.
HOLD = """
import sys, time
from pathlib import Path
if __name__ == "__main__":
    from experiments.study.compute.executors import open_executor
    from tests.experiments.study.misbehaving import FAULTS, Sum
    executor, _ = open_executor("local", 2, Path(sys.argv[1]), 25)
    tasks = [Sum(name, Path(sys.argv[1]), fault="hold", times=1) for name in "ab"]
    for task in tasks:
        task.folder.mkdir(parents=True)
        executor.submit(task.compute, print)
    time.sleep(600)
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.long)])
def test_workers_that_hold_the_interpreter_end_with_their_parent(tmp_path: Path, number: int) -> None:
    script = tmp_path / "driver.py"
    script.write_text(HOLD)
    process = started(script, tmp_path)
    wait_for(lambda: len(list(tmp_path.glob("*.tries"))) == 2, 60)
    time.sleep(0.5)  # until they are in the call
    found = children(process.pid, "spawn_main")
    assert len(found) == 2
    os.kill(process.pid, number)
    process.communicate(timeout=30)
    wait_for(lambda: not any(map(is_alive, found)), 30)


def watch_without_fcntl(started: Path) -> None:
    """What a worker does on a system without it."""
    local.fcntl = None
    local.end_with_parent()
    started.write_text(str(os.getpid()))
    time.sleep(600)


WATCHED = """
import multiprocessing, sys, time
from pathlib import Path
from tests.experiments.study.test_orphans import watch_without_fcntl
if __name__ == "__main__":
    multiprocessing.get_context("spawn").Process(target=watch_without_fcntl, args=(Path(sys.argv[1]),)).start()
    time.sleep(600)
"""


def test_a_worker_ends_with_its_parent_without_fcntl(tmp_path: Path) -> None:
    (tmp_path / "driver.py").write_text(WATCHED)
    process, note = started(tmp_path / "driver.py", tmp_path / "pid"), tmp_path / "pid"
    wait_for(lambda: note.exists() and note.read_text() != "", 120)
    process.kill()
    process.communicate(timeout=30)
    wait_for(lambda: not is_alive(int(note.read_text())), 30)


def test_experiments_can_be_imported_without_fcntl() -> None:
    python(
        "-c",
        "import sys; sys.modules['fcntl'] = None; import experiments.sweep",
    )
