"""The table of peers where EnvPool is not installed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from experiments import peers


@pytest.mark.slow
def test_without_envpool_the_others_are_compared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexit 1\n")  # as a Python that cannot import envpool
    python.chmod(0o755)
    rows = list(peers.measure("u-turn", python, turns=1, seconds=0.02, seeds=3, episodes=1))
    assert [row["of"] for row in rows] == ["highway-env, u-turn", "replica, u-turn", "sumo, u-turn"]
    assert f"EnvPool is left out: {python}" in capsys.readouterr().err
    for row in rows:
        assert row["steps_per_second"] > 0.0 and row["crash_rates"].keys() == {"idle", "faster", "slower"}
    stock, replica, _ = (json.dumps([row["distinct"], row["crash_rates"]]) for row in rows)
    assert stock == replica
