"""Thousands of episodes in one process cost no memory, leave nothing behind and change nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BOUND = 8.0  # [MiB] that a process may grow after its first block
EPISODES = 2000


@pytest.mark.long
@pytest.mark.parametrize("task", ["highway", "two-way", "roundabout", "intersection", "u-turn"])
def test_a_long_run(task: str, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.sumo_env.endurance", task, str(tmp_path)]
    subprocess.run([*command, "--episodes", str(EPISODES)], cwd=ROOT, check=True, timeout=3600)
    lines = [json.loads(line) for line in (tmp_path / f"{task}.jsonl").read_text().splitlines()]
    first, last = lines[0], lines[-1]
    assert last["episodes"] == EPISODES
    assert [line["always"] for line in lines] == [first["always"]] * len(lines)
    assert len(first["always"]) == 1  # in this process and in workers
    for before, after in zip(first["resident_mib"], last["resident_mib"], strict=True):
        assert after < before + BOUND
    assert last["descriptors"] <= first["descriptors"]
    assert last["files"] <= first["files"]
