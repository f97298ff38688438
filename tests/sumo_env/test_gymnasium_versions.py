"""The oldest gymnasium that is allowed, and one between it and ours: pip fetches them, so this is a long test."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.processes import ROOT, python

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
