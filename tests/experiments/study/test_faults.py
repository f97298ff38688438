"""Processes that are killed at random: nothing is lost, and the results are the same."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from collections import Counter
from pathlib import Path

import pytest

from experiments.analysis.analysis import analyse, as_json
from experiments.study.store import load
from tests.experiments.computed import fingerprint
from tests.processes import children, python, started

TWO_SEEDS = {"preset": "smoke", "tasks": ["u-turn"], "seeds": 2, "updates": 400, "episodes": 10, "workers": 2}
WANTED = 20


def sweep(directory: Path) -> tuple[str, ...]:
    return (str(Path(__file__).with_name("fake_sweep.py")), str(directory), json.dumps(TWO_SEEDS))


def analysis(directory: Path) -> str:
    """What the report says, without where and when it was computed."""
    return json.dumps({**as_json(analyse(load(directory))), "provenance": None})


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_twenty_random_kills_lose_nothing_and_change_nothing(tmp_path):
    """kill -9 at random times of workers and of the sweep itself, which is then begun again.

    Every day, tests/experiments/test_sweep.py kills a worker, and a sweep twice.

    The times are relative to what a sweep takes on this machine now: on a slow one nothing would ever get done between
    two kills that are seconds apart.
    """
    reference, start = tmp_path / "reference", time.monotonic()
    python(*sweep(reference))
    duration = time.monotonic() - start
    rng, kills, tries = random.Random(2), Counter(), 0
    while kills.total() < WANTED:
        tries += 1
        assert tries <= 10, kills
        directory = tmp_path / str(tries)
        again = True
        while again:
            process = started(*sweep(directory))
            again = False
            while process.poll() is None and not again and kills.total() < WANTED:
                time.sleep(rng.uniform(0.0, duration / 2))
                victim = "sweep" if rng.random() < 0.5 else "worker"
                workers = children(process.pid, "spawn_main")
                if process.poll() is None and (victim == "sweep" or workers):
                    os.kill(process.pid if victim == "sweep" else rng.choice(workers), signal.SIGKILL)
                    kills[victim] += 1
                    again = victim == "sweep"
            output = process.communicate(timeout=600)
            assert again or process.returncode in (0, 1), output
            again = again or process.returncode == 1  # a cell met four kills: the same command tries it again
        assert fingerprint(directory) == fingerprint(reference)
        assert analysis(directory) == analysis(reference)
        assert not list((directory / "work").iterdir())
        assert not (directory / "damaged").exists()
    print(f"{kills} in {tries} sweeps")
    assert kills["worker"] and kills["sweep"]
