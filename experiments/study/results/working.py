"""The working folder of a task, where the process that computes it and all others meet.

lock           held with flock by the process that computes; the kernel releases it, however the process ends
progress.json  the share that is done
log.txt        what went wrong, with the stack of every thread after a crash or a hang
"""

import os
from pathlib import Path

LAST = 10_000  # bytes of a log that are looked at
LOCK, PROGRESS, LOG = "lock", "progress.json", "log.txt"


def fraction_done(folder: Path) -> float:
    """The share of a running task that is done, 0 if it has not said so yet."""
    try:
        return float((folder / PROGRESS).read_text())
    except (OSError, ValueError):
        return 0.0


def last_words(folder: Path) -> str:
    """The last line of a task's log, which names what went wrong; empty if nothing has since it was begun last."""
    try:
        # A try begins by saying that nothing is done.
        if _changed(folder / LOG) < _changed(folder / PROGRESS):
            return ""
        with (folder / LOG).open("rb") as file:
            file.seek(max(os.fstat(file.fileno()).st_size - LAST, 0))
            return file.read(LAST).decode(errors="replace").rstrip().rpartition("\n")[2]
    except OSError:
        return ""


def _changed(path: Path) -> int:
    """When a file was written last [ns], 0 if it is not there."""
    return path.stat().st_mtime_ns if path.exists() else 0
