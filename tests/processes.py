"""Commands in processes of their own, and what processes there are, from /proc."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def variables(own: dict[str, str]) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), **own}


def ended(
    *arguments: object, cwd: Path = ROOT, stdin: str | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """A Python of its own with these arguments and variables, once it has ended, with all that holds its output."""
    command = [sys.executable, *map(str, arguments)]
    return subprocess.run(
        command,
        cwd=cwd,
        env=variables(environment),
        input=stdin,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def python(*arguments: object, **options: Any) -> str:
    """What a Python of its own prints, as `ended`; it must end well."""
    done = ended(*arguments, **options)
    assert done.returncode == 0, f"{done.returncode}: {done.stdout[-2000:]}{done.stderr[-2000:]}"
    return done.stdout


def started(*arguments: object, **environment: str) -> subprocess.Popen[str]:
    """As `ended`, but while it runs: a process group of its own, to which Ctrl-C means something."""
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=variables(environment),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests in the background ignore it
    )


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


def ends(pid: int) -> bool:
    """Whether a process ends soon."""
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
