"""``python -m sumo_env``: what it says, and with which exit status."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import sumo_env
from sumo_env import __main__ as doctor
from tests.processes import ROOT, python


def test_the_version_of_gymnasium_comes_first_and_the_folder_is_named(monkeypatch, capsys) -> None:
    """An old one makes later checks fail for reasons that mislead."""
    monkeypatch.setattr(doctor.gym, "__version__", "0.29.1")
    assert doctor.examine(doctor.CHECKS) == 1
    folder, first = capsys.readouterr().out.splitlines()[:2]
    assert str(Path(sumo_env.__file__).parent) in folder
    assert "FAIL  gymnasium" in first
    declared = re.search(r"gymnasium>=[\d.]+", (ROOT / "pyproject.toml").read_text())
    assert declared is not None and f"pip install '{declared[0]}'" in first


@pytest.mark.slow
def test_a_sound_installation_passes() -> None:
    said = python("-m", "sumo_env")  # the doctor
    assert "all is well" in said
    assert "FAIL" not in said
    for id in sumo_env.IDS:
        (line,) = [line for line in said.splitlines() if f" {sumo_env.task_of(id)} " in line]
        assert "steps/s" in line


def test_a_problem_is_told_and_ends_the_examination(monkeypatch, capsys) -> None:
    def never() -> str:
        raise AssertionError("this check rests on the one before")

    monkeypatch.delitem(sys.modules, "sumo_env.sumo.engine", raising=False)
    monkeypatch.setitem(sys.modules, "libsumo", None)  # an import raises ImportError
    checks = (("first", lambda: "fine"), ("SUMO", doctor.sumo), ("third", never))
    assert doctor.examine(checks) == 1
    said = capsys.readouterr().out
    assert "ok    first" in said and "FAIL  SUMO" in said and "SUMO is missing" in said
    assert "pip install libsumo==" in said and "third" not in said


SCRIPT = """
import sys
import gymnasium as gym
import sumo_env
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

assert gym.__version__ == sys.argv[1], gym.__version__
for id in sumo_env.IDS:
    env = gym.make(id)
    check_env(env.unwrapped, skip_render_check=True)
    env.close()
for mode in (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP):
    envs = gym.make_vec("sumo/u-turn-v0", num_envs=2, autoreset_mode=mode)
    envs.reset(seed=0)
    for _ in range(15):
        envs.step(envs.action_space.sample())
    envs.close()
"""


@pytest.mark.long
@pytest.mark.parametrize("version", ["1.1.0", "1.2.2", "1.3.0"])
def test_environments_work_on_an_older_gymnasium(version: str, tmp_path: Path) -> None:
    """Alone, checked by gymnasium, and as vector environments."""
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", "install", "--no-deps"]
    subprocess.run([*pip, "--target", tmp_path / "older", f"gymnasium=={version}"], check=True)
    path = os.pathsep.join((str(tmp_path / "older"), str(ROOT)))
    python("-W", "ignore", "-c", SCRIPT, version, PYTHONPATH=path)
