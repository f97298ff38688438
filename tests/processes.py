"""What processes there are, from /proc."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def python(*arguments: object, **environment: str) -> str:
    """What a Python of its own prints, with these arguments and variables; it must end well."""
    options: dict[str, Any] = {"capture_output": True, "text": True, "cwd": ROOT, "timeout": 300}
    done = subprocess.run(
        [sys.executable, *map(str, arguments)], env={**os.environ, **environment}, **options
    )
    assert done.returncode == 0, f"{done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return str(done.stdout)


def children(parent: int, word: str = "") -> list[int]:
    """Living processes that a process has started, with this word in their command line."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            owner = int((path / "stat").read_text().rpartition(")")[2].split()[1])
            line = (path / "cmdline").read_bytes()
        except OSError:
            continue
        if owner == parent and word.encode() in line and is_alive(int(path.name)):
            found.append(int(path.name))
    return found


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


def ends(pid: int | None) -> bool:
    """Whether a process ends soon."""
    assert pid is not None
    wait_for(lambda: not is_alive(pid), 30.0)
    return True


def descriptors(pid: int | None = None) -> int:
    """Number of open file descriptors of a process, this one by default."""
    return len(os.listdir(f"/proc/{pid or 'self'}/fd"))


def wait_for(condition: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)
