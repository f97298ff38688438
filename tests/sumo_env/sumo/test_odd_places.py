"""Folders, search paths and Pythons that other people have: the environments work in them, or say what is wrong."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest

from sumo_env.config import ConfigError
from sumo_env.networks.mapping import network
from sumo_env.sumo import pipe, process
from sumo_env.traffic import sumo_files
from tests.processes import python

# SUMO takes a comma as the end of a name, and ${HOME} as a variable; PYTHONPATH takes a colon as the end of a name.
NAME = "one, two: ${HOME} $HOME%2C;"
# Two environments, the second one in a worker, on the u-turn and on its network as a network of one's own.
DRIVE = """
import sys
from sumo_env.env import DrivingEnv, SumoDrivingEnv
from sumo_env.networks.mapping import network
routes = network("u-turn").routes
envs = []
for _ in range(2):
    env = SumoDrivingEnv(*sys.argv[1:], routes, routes["a-b>d"]) if sys.argv[1:] else DrivingEnv("u-turn")
    envs.append(env)
    env.reset(seed=0)
    print(repr([float(value) for value in env.step(1)[0].ravel()]))
print(envs[1]._simulator.pid is not None)
"""


@pytest.fixture(scope="module")
def expected() -> list[str]:
    return python("-c", DRIVE).splitlines()


def test_the_package_temporary_files_and_the_working_folder_may_be_anywhere(
    tmp_path: Path, expected: list[str]
) -> None:
    """The networks of the five tasks are in the package."""
    folder = tmp_path / NAME
    package = folder / "sumo_env"
    ignored = shutil.ignore_patterns("__pycache__", "networks")
    shutil.copytree(Path(process.__file__).parents[1], package, ignore=ignored)
    shutil.copytree(Path(network("u-turn").net_file).parents[1], package / "networks", ignore=ignored)
    assert python("-c", DRIVE, cwd=folder, TMPDIR=str(folder), PYTHONPATH="").splitlines() == expected
    assert expected[0] == expected[1] and expected[2] == "True"
    assert [path.name for path in folder.iterdir()] == ["sumo_env"]


def test_without_a_folder_for_links_the_folders_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert sumo_files.plain_path(tmp_path / "plain") == tmp_path / "plain"
    link = sumo_files.plain_path(tmp_path / "a,b" / "c")
    assert "," not in str(link) and link.parent.readlink() == tmp_path / "a,b"
    monkeypatch.setattr(sumo_files.os, "access", lambda *_: False)
    monkeypatch.setattr(sumo_files, "_folders", {})
    with pytest.raises(ConfigError, match=r"TMPDIR \(tried: .*/tmp"):
        sumo_files.plain_path(tmp_path / "d,e" / "f")


def test_an_embedded_python_finds_a_program_for_workers(expected: list[str]) -> None:
    """Nor does it matter what else is in the search path."""
    odd = "import sys, pathlib; sys.executable = None; sys.path += [pathlib.Path('/tmp'), b'/tmp', None]\n"
    assert python("-c", odd + DRIVE).splitlines() == expected


@pytest.mark.parametrize("executable", [None, "", "/bin/true"])
def test_a_program_is_found_beside_the_library(executable: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    known = pipe.interpreter()
    monkeypatch.setattr(sys, "executable", executable)
    monkeypatch.setattr("multiprocessing.spawn._python_exe", None)
    assert Path(pipe.interpreter()).resolve() == Path(known).resolve()
    monkeypatch.setattr("multiprocessing.spawn._python_exe", b"/bin/sh")
    assert pipe.interpreter() == "/bin/sh"
