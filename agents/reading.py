"""Which files somebody's code reads while it is run: weights beside a policy's code are a part of what it is."""

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

_here = threading.local()  # .opened: what this thread has opened for reading, where somebody asks for it
# Of the system, of the interpreter and its libraries, and what they write for themselves.
SYSTEM = (*map(Path, ("/proc", "/sys", "/dev", "/etc")), Path(sys.prefix), Path(sys.base_prefix))
THEIRS = {"__pycache__", ".cache", ".config"}


@contextmanager
def files_read() -> Iterator[set[Path]]:
    """The regular files that this thread reads, as a set that is complete at the end.

    Code (a policy's own is known by its file), libraries and their caches are left out. What a library opens without
    Python, as some written in C++ do, is not seen.
    """
    _listen()
    before, _here.opened = getattr(_here, "opened", None), set[Any]()
    found = set[Path]()
    try:
        yield found
        found |= {path for path in map(_resolved, _here.opened) if path is not None}
    finally:
        _here.opened = before


@cache
def _listen() -> None:
    """Be told of every file that Python opens (`sys.addaudithook`, which cannot be taken back)."""

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event != "open" or (opened := getattr(_here, "opened", None)) is None:
            return
        path, mode, flags = arguments
        writes = set(mode) & set("wax+") if mode else flags & (os.O_WRONLY | os.O_RDWR)
        if not writes and not isinstance(path, int):
            opened.add(path)

    sys.addaudithook(hook)


def _resolved(opened: Any) -> Path | None:
    """The file that was opened; None where it does not belong to what code is."""
    path = Path(os.fsdecode(opened)).resolve()
    if path.suffix in (".py", ".pyc") or THEIRS & set(path.parts) or not path.is_file():
        return None
    return None if any(path.is_relative_to(folder) for folder in SYSTEM) else path
