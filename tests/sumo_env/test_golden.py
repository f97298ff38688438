"""Trajectories stay what they were. A change that is meant: python tests/golden/regenerate.py, and review the diff."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

from sumo_env.tasks import TASKS

GOLDEN = Path(__file__).resolve().parents[1] / "golden"
TOLERANCE = 1e-3  # [m, m/s, rad] rounding differs between machines; a changed rule moves cars by more


def _generator() -> Any:
    spec = importlib.util.spec_from_file_location("regenerate", GOLDEN / "regenerate.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("traffic", ["regular", "risky"])
@pytest.mark.parametrize("task", list(TASKS))
def test_trajectory_is_the_golden_one(task: str, traffic: str) -> None:
    golden = json.loads((GOLDEN / f"{task}-{traffic}.json").read_text())
    driven = _generator().trajectory(task, traffic)
    assert len(driven["steps"]) == len(golden["steps"])
    for now, then in zip(driven["steps"], golden["steps"], strict=True):
        assert list(now["vehicles"]) == list(then["vehicles"]), f"other vehicles at {then['time']} s"
        assert now["reward"] == pytest.approx(then["reward"], abs=TOLERANCE)
        for name, values in then["vehicles"].items():
            assert now["vehicles"][name] == pytest.approx(values, abs=TOLERANCE), (
                f"{name} at {then['time']} s"
            )
