"""No worker outlives the command that started it, however that one ends and whatever the worker is doing."""

import os
import shlex
import signal
import time
from pathlib import Path

import pytest

from tests.processes import children, is_alive, python_again, started, wait_for

# Workers in a call into C that never gives the interpreter back, as in a compiler.
HOLD = """
import sys, time
from pathlib import Path
if __name__ == "__main__":
    from experiments.study.compute.executors import open_executor
    from tests.experiments.study.misbehaving import FAULTS, Sum
    executor, _ = open_executor("local", 2, Path(sys.argv[1]), 25, 2)
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


# A run whose tasks wait.
WAITS = """
import sys
from pathlib import Path
from experiments.study.compute.executors import open_executor
from experiments.study.compute.run import run
from experiments.support.errors import run_command
from tests.experiments.study.misbehaving import Sum
def main():
    folder = Path(sys.argv[1])
    tasks = [Sum(name, folder, pause=600.0, silence=900.0) for name in "ab"]
    return bool(run(tasks, *open_executor("local", 2, folder, 25, len(tasks))))
if __name__ == "__main__":
    run_command(main, resumes=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "send"),
    [
        (signal.SIGINT, os.killpg),
        *(pytest.param(signal.SIGTERM, send, marks=pytest.mark.long) for send in (os.kill, os.killpg)),
    ],
)
def test_a_stopped_run_says_how_to_go_on_and_leaves_no_process(tmp_path: Path, number: int, send) -> None:
    """To the process alone as by `kill`, and to the whole group as by a terminal or a scheduler."""
    script = tmp_path / "driver.py"
    script.write_text(WAITS)
    process = started(script, tmp_path)
    wait_for(lambda: len(list(tmp_path.glob("*.tries"))) == 2, 300)
    workers = children(process.pid, "spawn_main")
    send(process.pid, number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and len(workers) == 2
    again = shlex.join(["python", str(script), str(tmp_path)])
    assert errors == f"interrupted; what is finished is kept. To go on: {again}\n"
    wait_for(lambda: not any(map(is_alive, workers)))


def test_experiments_can_be_imported_without_fcntl() -> None:
    python_again("-c", "import sys; sys.modules['fcntl'] = None; import experiments.sweep")
