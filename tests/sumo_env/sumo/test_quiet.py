"""What libsumo prints does not get into a user's output."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = f"""
import importlib.metadata, sys
sys.path.insert(0, {str(ROOT)!r})
version = importlib.metadata.version
importlib.metadata.version = lambda name: "99.0.0" if name == "pyarrow" else version(name)
from sumo_env.env import DrivingEnv
DrivingEnv("u-turn").reset(seed=0)
"""


def test_another_version_of_pyarrow_prints_nothing() -> None:
    done = subprocess.run([sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True)
    assert done.stdout == ""
