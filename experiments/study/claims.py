"""Who computes which cell: lock files with a heartbeat, so that sweeps on one directory share the work.

A claim is a file ``claims/<cell>.lock`` that names its owner (machine, process, start of the process) and is
touched every few seconds. It is taken away from its owner only when the owner is certainly or presumably
dead: the process does not exist any more (same machine), or the file was not touched for a minute (another
machine on a shared disk). Looking and taking happen under a `flock` of ``claims/.mutex``, which the kernel
gives back when its holder is killed: two processes never take over the same stale claim.

Should a process wrongly be thought dead (asleep for a minute), two compute the same cell, get the same bits
and one of the results is kept: a waste, not an error.
"""

from __future__ import annotations

import fcntl
import json
import os
import socket
import threading
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STALE_AFTER = 60.0  # [s] without heartbeat, from another machine
BEAT = 5.0  # [s] between heartbeats


def machine() -> str:
    """Name of this machine as far as process numbers are concerned (host, boot, process namespace)."""
    parts = [socket.gethostname()]
    try:
        parts.append(Path("/proc/sys/kernel/random/boot_id").read_text().strip())
        parts.append(os.readlink("/proc/self/ns/pid"))
    except OSError:  # not Linux: the host name has to do
        pass
    return "/".join(parts)


def process_start(pid: int) -> str | None:
    """When a process of this machine began, in the kernel's own count; None if it does not exist.

    Tells a process from a later one with the same number. A zombie counts as gone.
    """
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except FileNotFoundError:
        if Path("/proc/self/stat").exists():
            return None
        try:  # not Linux
            os.kill(pid, 0)
        except ProcessLookupError:
            return None
        except PermissionError:
            pass
        return "unknown"
    except ProcessLookupError:
        return None
    return None if fields[0] in "ZX" else fields[19]


@dataclass
class Claim:
    """A cell that this process may compute; release it when done."""

    path: Path
    token: str

    def beat(self) -> None:
        """Tell the others that the owner is alive."""
        if self.is_mine():
            with suppress(FileNotFoundError):  # released in this moment
                os.utime(self.path)

    def is_mine(self) -> bool:
        """False once another process has taken the claim over."""
        owner = _read(self.path)
        return owner is not None and owner.get("token") == self.token

    def release(self) -> None:
        """Give the cell up, finished or not."""
        if self.is_mine():
            self.path.unlink(missing_ok=True)


class Claims:
    """The claims of one result directory.

    Args:
        directory: where the lock files lie; made if it is missing.
        stale_after: age [s] at which a claim from another machine counts as abandoned.
    """

    def __init__(self, directory: Path, stale_after: float = STALE_AFTER) -> None:
        self.directory = directory
        self.stale_after = stale_after
        directory.mkdir(parents=True, exist_ok=True)

    def acquire(self, name: str) -> Claim | None:
        """Claim a cell; None while another living process holds it."""
        path = self._path(name)
        with self._mutex() as now:
            if self._is_held(path, now):
                return None
            claim = Claim(path, uuid.uuid4().hex)
            owner = {
                "machine": machine(),
                "pid": os.getpid(),
                "start": process_start(os.getpid()),
                "token": claim.token,
            }
            temporary = path.with_suffix(".new")
            temporary.write_text(json.dumps(owner))
            os.replace(temporary, path)
        return claim

    def holder(self, name: str) -> str | None:
        """The living owner of a claim in words ("process 17 on host"), or None."""
        path = self._path(name)
        with self._mutex() as now:
            if not self._is_held(path, now):
                return None
            owner = _read(path) or {}
        return f"process {owner.get('pid')} on {str(owner.get('machine')).partition('/')[0]}"

    def _path(self, name: str) -> Path:
        return self.directory / f"{name}.lock"

    def _is_held(self, path: Path, now: float) -> bool:
        owner = _read(path)
        if owner is None:
            return False
        if owner.get("machine") == machine():
            return process_start(int(owner.get("pid", -1))) == owner.get("start")
        try:
            return now - path.stat().st_mtime < self.stale_after
        except FileNotFoundError:  # released in this moment
            return False

    @contextmanager
    def _mutex(self) -> Iterator[float]:
        """Hold the directory's mutex; yields the time by the filesystem's clock, which all machines share."""
        with (self.directory / ".mutex").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            os.utime(file.fileno())
            yield os.fstat(file.fileno()).st_mtime


def _read(path: Path) -> dict[str, Any] | None:
    """The owner written in a lock file; None if the file is gone or was damaged."""
    try:
        owner = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):
        return None
    return owner if isinstance(owner, dict) else None


class Heart(threading.Thread):
    """Touches the claims of a worker process, and ends the process when its parent has died.

    A daemon thread: it stops with the process, also in a segmentation fault, and then the claims are free.
    """

    def __init__(self, parent: int, interval: float = BEAT) -> None:
        super().__init__(name="heart", daemon=True)
        self.claims: list[Claim] = []
        self._parent = parent
        self._interval = interval
        self._stopped = threading.Event()

    def run(self) -> None:
        """Beat until stopped."""
        elapsed = 0.0
        while not self._stopped.wait(1.0):
            if os.getppid() != self._parent:
                os._exit(1)  # orphaned: whoever starts the sweep again takes over from the last checkpoint
            elapsed += 1.0
            if elapsed >= self._interval:
                elapsed = 0.0
                for claim in list(self.claims):
                    claim.beat()

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()
