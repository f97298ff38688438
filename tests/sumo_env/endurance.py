"""A long run: thousands of episodes of one task in one process, and what they leave behind.

    python -m tests.sumo_env.endurance highway DIR --episodes 10000 --minutes 20

Three environments are alive, one in this process and two in workers, and take turns; every second episode is risky.
After every BLOCK episodes each environment drives a regular and a risky episode that are always the same. A line about
each block is appended to DIR/TASK.jsonl; the same command goes on after the last line, in a new process.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path
from typing import Any

from sumo_env.env import DrivingEnv
from tests.processes import children
from tests.sumo_env.rollout import digest, record

ENVIRONMENTS, BLOCK = 3, 250


def endure(task: str, directory: Path, episodes: int, seconds: float = float("inf")) -> list[dict[str, Any]]:
    """Drive so many episodes, for so long at most [s], and return the lines about all blocks so far.

    Raises:
        AssertionError: a process, a file or an open descriptor is left after the environments are closed.
    """
    file = directory / f"{task}.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    done = lines[-1]["episodes"] if lines else 0
    files = directory / f"files-{os.getpid()}"
    files.mkdir(parents=True)
    tempfile.tempdir = str(files)  # of this process and its workers
    descriptors = len(os.listdir("/proc/self/fd"))
    envs = [DrivingEnv(task) for _ in range(ENVIRONMENTS)]
    start = time.monotonic()
    while done < episodes and time.monotonic() - start < seconds:
        for number in range(done, min(done + BLOCK, episodes)):
            episode(envs[number % ENVIRONMENTS], number // ENVIRONMENTS % 2, number)
            done = number + 1
        always = {" ".join(episode(env, risk, 0) for risk in (0, 1)) for env in envs}
        workers = children(os.getpid())
        line = {
            "task": task,
            "episodes": done,
            "process": os.getpid(),
            "seconds": round(time.monotonic() - start, 1),
            "always": sorted(always),
            "resident_mib": [round(resident(pid), 1) for pid in (os.getpid(), *workers)],
            "descriptors": len(os.listdir("/proc/self/fd")),
            "files": sum(len(names) for _, _, names in os.walk(files)),
        }
        lines.append(line)
        with file.open("a") as stream:
            stream.write(json.dumps(line) + "\n")
    for env in envs:
        env.close()
    left = [
        *children(os.getpid()),
        *files.iterdir(),
        *range(len(os.listdir("/proc/self/fd")) - descriptors),
    ]
    assert not left, left
    files.rmdir()
    return lines


def episode(env: DrivingEnv, risk: int, seed: int) -> str:
    """Drive an episode under pseudo-random actions; returns the digest of all that was seen."""
    env.configure({"risk": float(risk)})
    return digest(record(env, seed))[:16]


def resident(pid: int) -> float:
    """Resident memory of a process [MiB]."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("task")
    parser.add_argument("directory", type=Path)
    parser.add_argument("--episodes", type=int, default=10_000)
    parser.add_argument("--minutes", type=float, default=float("inf"))
    given = parser.parse_args()
    for line in endure(given.task, given.directory, given.episodes, 60 * given.minutes)[-1:]:
        print(json.dumps(line))


if __name__ == "__main__":
    main()
