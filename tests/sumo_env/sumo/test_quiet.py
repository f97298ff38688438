"""What libsumo prints does not get into a user's output."""

from __future__ import annotations

from tests.processes import python

SCRIPT = """
import importlib.metadata
version = importlib.metadata.version
importlib.metadata.version = lambda name: "99.0.0" if name == "pyarrow" else version(name)
from sumo_env.env import DrivingEnv
DrivingEnv("u-turn").reset(seed=0)
"""


def test_another_version_of_pyarrow_prints_nothing() -> None:
    assert python("-c", SCRIPT) == ""
