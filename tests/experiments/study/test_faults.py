"""A disk that fills up, and processes that are killed at random: nothing is lost, and the results are the same."""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from experiments.analysis.analysis import analyse, as_json
from experiments.study.store import load
from tests.experiments.computed import fingerprint
from tests.processes import children

pytestmark = pytest.mark.slow  # whole sweeps in processes of their own, several times

TWO_SEEDS = {"preset": "smoke", "tasks": ["u-turn"], "seeds": 2, "updates": 400, "episodes": 10, "workers": 2}
SWEEP = [sys.executable, str(Path(__file__).with_name("fake_sweep.py"))]


def command(directory: Path) -> list[str]:
    return [*SWEEP, str(directory), json.dumps(TWO_SEEDS)]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> tuple[Path, float]:
    """A sweep to compare with, and the time that it took [s]."""
    directory = tmp_path_factory.mktemp("reference")
    start = time.monotonic()
    subprocess.run(command(directory), check=True, capture_output=True, timeout=600)
    return directory, time.monotonic() - start


@pytest.fixture(scope="module")
def reference(undisturbed) -> Path:
    return undisturbed[0]


def analysis(directory: Path) -> str:
    """What the report says, without where and when it was computed."""
    value = as_json(analyse(load(directory)))
    return json.dumps({name: entry for name, entry in value.items() if name != "provenance"})


# In a mount namespace: a file system of 20 MB, of which so many KiB are left, fills up; then there is room again.
FULL = """
set -e
mount -t tmpfs -o size=20m none "$1"
head -c $((20 * 1024 * 1024 - $2 * 1024)) /dev/zero > "$1/filler"
set +e
"$4" "$5" "$1/results" "$6"; echo "status $?"
rm "$1/filler"
"$4" "$5" "$1/results" "$6"; echo "status $?"
cp -r "$1/results" "$3"
"""


@pytest.mark.long
@pytest.mark.parametrize("headroom", [0, 40, 300, 1200], ids=lambda kib: f"{kib}KiB")
def test_a_disk_that_fills_up_stops_the_sweep_in_one_line_and_loses_nothing(reference, tmp_path, headroom):
    namespace = ["unshare", "--map-root-user", "--mount"]
    if (
        shutil.which("unshare") is None
        or subprocess.run([*namespace, "true"], capture_output=True).returncode
    ):
        pytest.skip("no mount namespaces here")
    disk = tmp_path / "disk"
    disk.mkdir()
    arguments = [str(disk), str(headroom), str(tmp_path / "copy"), *SWEEP, json.dumps(TWO_SEEDS)]
    result = subprocess.run(
        [*namespace, "sh", "-c", FULL, "sh", *arguments], capture_output=True, text=True, timeout=600
    )
    assert result.returncode == 0, result.stderr
    assert [line for line in result.stdout.splitlines() if line.startswith("status")] == [
        "status 2",
        "status 0",
    ]
    errors = result.stderr.splitlines()
    assert len(errors) == 1, result.stderr
    assert "no space left on the disk" in errors[0]
    assert "run the same command again" in errors[0]
    assert fingerprint(tmp_path / "copy") == fingerprint(reference)
    assert not (tmp_path / "copy" / "damaged").exists()


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_twenty_random_kills_lose_nothing_and_change_nothing(undisturbed, tmp_path):
    """kill -9 at random times of workers and of the sweep itself, which is then begun again.

    Every day, tests/experiments/test_sweep.py kills a worker, and a sweep twice.

    The times are relative to what a sweep takes on this machine now: on a slow one nothing would ever get done between
    two kills that are seconds apart.
    """
    reference, duration = undisturbed
    rng, wanted = random.Random(2), 20
    kills = {"worker": 0, "sweep": 0}
    tries = 0
    while sum(kills.values()) < wanted:
        tries += 1
        assert tries <= 10, kills
        directory = tmp_path / str(tries)
        again = True
        while again:
            process = subprocess.Popen(
                command(directory), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
            )
            again = False
            while process.poll() is None and sum(kills.values()) < wanted:
                time.sleep(rng.uniform(0.0, duration / 2))
                victim = "sweep" if rng.random() < 0.5 else "worker"
                workers = children(process.pid, "spawn_main")
                if process.poll() is not None or (victim == "worker" and not workers):
                    continue
                os.kill(process.pid if victim == "sweep" else rng.choice(workers), signal.SIGKILL)
                kills[victim] += 1
                if victim == "sweep":
                    again = True
                    break
            output = process.communicate(timeout=600)[0]
            assert again or process.returncode in (0, 1), output
            again = again or process.returncode == 1  # a cell met four kills: the same command tries it again
        assert fingerprint(directory) == fingerprint(reference)
        assert analysis(directory) == analysis(reference)
        assert not list((directory / "work").iterdir())
        assert not (directory / "damaged").exists()
    print(f"{kills} in {tries} sweeps")
    assert all(kills.values())
