"""No worker outlives the command that started it, however that one ends and whatever the worker is doing."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from tests.processes import children, is_alive, started, wait_for

# Workers in a call into C that never gives the interpreter back, as in a compiler.
HOLD = """
import sys, time
from pathlib import Path
if __name__ == "__main__":
    from experiments.study.executors import open_executor
    from tests.experiments.study.misbehaving import FAULTS, Sum
    executor, _ = open_executor("local", 2, Path(sys.argv[1]), 25)
    tasks = [Sum(name, Path(sys.argv[1]), fault="hold", times=1) for name in "ab"]
    for task in tasks:
        task.folder.mkdir(parents=True)
        executor.submit(task.compute, print)
    time.sleep(600)
"""


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_workers_that_hold_the_interpreter_end_with_their_parent(tmp_path: Path, number: int) -> None:
    script = tmp_path / "driver.py"
    script.write_text(HOLD)
    process = started(script, tmp_path)
    wait_for(lambda: len(list(tmp_path.glob("work/*/checkpoint"))) == 2, 60)
    time.sleep(0.5)  # until they are in the call
    found = children(process.pid, "spawn_main")
    assert len(found) == 2
    os.kill(process.pid, number)
    process.communicate(timeout=30)
    wait_for(lambda: not any(map(is_alive, found)), 30)
