"""Folders, search paths and Pythons that other people have: the environments work in them, or say what is wrong."""

import shutil
import signal
import sys
from pathlib import Path
from typing import Any

import pytest

from sumo_env.networks.mapping import network
from sumo_env.networks.roads import road
from sumo_env.simulator import SimulatorError
from sumo_env.sumo import pipe, process
from tests.processes import ended, python, started

# SUMO takes a comma as the end of a name, and ${HOME} as a variable; PYTHONPATH takes a colon as the end of a name.
NAME = "one, two: ${HOME} $HOME%2C;"
# The second environment is in a worker.
DRIVE = """
from sumo_env.env import DrivingEnv
envs = [DrivingEnv("u-turn") for _ in range(2)]
for env in envs:
    env.reset(seed=0)
    print(repr([float(value) for value in env.step(1)[0].ravel()]))
print(envs[1]._car.episode.simulator.pid is not None)
"""


@pytest.fixture(scope="module")
def expected() -> list[str]:
    return python("-c", DRIVE).splitlines()


def test_the_package_temporary_files_and_the_working_folder_may_be_anywhere(tmp_path, expected) -> None:
    """The networks of the five tasks are in the package."""
    folder = tmp_path / NAME
    package = folder / "sumo_env"
    ignored = shutil.ignore_patterns("__pycache__", "networks")
    shutil.copytree(Path(process.__file__).parents[1], package, ignore=ignored)
    shutil.copytree(Path(network(road("u-turn")).net_file).parents[1], package / "networks", ignore=ignored)
    assert python("-c", DRIVE, cwd=folder, TMPDIR=str(folder), PYTHONPATH="").splitlines() == expected
    assert expected[0] == expected[1] and expected[2] == "True"
    assert [path.name for path in folder.iterdir()] == ["sumo_env"]


def test_the_folder_of_a_killed_process_is_deleted_by_a_later_one(tmp_path: Path) -> None:
    """That of a process that is alive is not."""
    mine = "from sumo_env.sumo.paths import own_folder\nprint(own_folder(), flush=True)\n"
    waits = mine + "import time\ntime.sleep(60)\n"
    alive, killed = (started("-c", waits, TMPDIR=str(tmp_path)) for _ in range(2))
    with alive, killed:
        folders = [Path(one.stdout.readline().strip()) for one in (alive, killed)]
        killed.kill()
        killed.wait()
        assert all(folder.is_dir() for folder in folders)
        python("-c", mine, TMPDIR=str(tmp_path))
        assert list(tmp_path.iterdir()) == folders[:1]
        alive.send_signal(signal.SIGINT)
    assert list(tmp_path.iterdir()) == []


def test_an_embedded_python_finds_a_program_for_workers(expected: list[str]) -> None:
    """Nor does it matter what else is in the search path, or whether the working folder is still there."""
    odd = (
        "import os, sys, pathlib; sys.executable = None; sys.path += [pathlib.Path('/tmp'), b'/tmp', None]\n"
    )
    odd += "os.mkdir('/tmp/gone-%d' % os.getpid()); os.chdir('/tmp/gone-%d' % os.getpid()); os.rmdir(os.getcwd())\n"
    assert python("-c", odd + DRIVE).splitlines() == expected


@pytest.mark.parametrize("executable", [None, "", "/bin/true"])
def test_a_program_is_found_beside_the_library(executable: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    known = pipe.interpreter()
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr("multiprocessing.spawn._python_exe", None)
    assert Path(pipe.interpreter()).resolve() == Path(known).resolve()
    monkeypatch.setattr("multiprocessing.spawn._python_exe", b"/bin/sh")
    assert pipe.interpreter() == "/bin/sh"
    monkeypatch.setattr("multiprocessing.spawn._python_exe", b"/nowhere/python")
    with pytest.raises(SimulatorError, match="set_executable"):
        pipe.interpreter()


SCRIPT = """
import importlib.metadata
version = importlib.metadata.version
importlib.metadata.version = lambda name: "99.0.0" if name == "pyarrow" else version(name)
from sumo_env.env import DrivingEnv
DrivingEnv("u-turn").reset(seed=0)
"""


def test_another_version_of_pyarrow_prints_nothing() -> None:
    assert python("-c", SCRIPT) == ""


TRAINS = """
import gymnasium as gym, numpy as np
CONFIG = {"vehicles_count": 5, "duration": 8}
make = lambda: gym.make("sumo_env:sumo/highway-v0", config=CONFIG)
if __name__ == "__main__":
    mine = [make() for _ in range(2)]
    for env in mine:
        env.reset(seed=0)
    envs = gym.vector.AsyncVectorEnv([make, make], context="START_METHOD")
    envs.reset()
    for _ in range(10):
        envs.step(np.array([1, 1]))
    envs.close()
    print(*(env.step(1)[4]["distance"] > 0 for env in mine))
"""


@pytest.mark.slow
@pytest.mark.parametrize("method", ["fork", "spawn", pytest.param("forkserver", marks=pytest.mark.long)])
def test_subprocesses_after_the_parent_has_used_sumo(tmp_path: Path, method: str) -> None:
    """Only multiprocessing's own start methods need a guard and a file; a notebook has none. No file is left."""
    text, file = TRAINS.replace("START_METHOD", method), tmp_path / "script.py"
    file.write_text(text)
    program, stdin = ("-", text) if method == "fork" else (file, "")
    done = ended("-W", "ignore::UserWarning", program, cwd=tmp_path, stdin=stdin, TMPDIR=str(tmp_path))
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith("sumo_env-")] == []
    assert done.stdout.splitlines()[-1] == "True True"
