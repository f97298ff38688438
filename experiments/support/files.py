"""Files that are either there whole or not there at all, whatever is killed in between."""

from __future__ import annotations

import errno
import hashlib
import io
import json
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from agents.files import atomic, open_regular
from agents.schema import parsed


def canonical_json(value: Any) -> str:
    """One text for one value: sorted keys, no spaces, no NaN. What hashes are taken of."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=True)


def plain_json(value: Any, digits: int = 17) -> Any:
    """A value as strict JSON has it: a number that is not finite is None, and text is the key of a dict.

    digits: significant ones that a float keeps; 17 are all.
    """
    if isinstance(value, dict):
        return {str(key): plain_json(item, digits) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_json(item, digits) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.{digits}g}") if math.isfinite(value) else None
    return value


def sha256_bytes(data: bytes) -> str:
    """Hexadecimal SHA-256 of some bytes."""
    return hashlib.sha256(data).hexdigest()


def sha256_file(path: Path) -> str:
    """Hexadecimal SHA-256 of the bytes of a file of results. Raises OSError as `opened` does."""
    with opened(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def opened(path: Path) -> io.BufferedReader:
    """A regular file of a folder of results, to be read. Raises OSError where a link, a folder or a pipe lies there."""
    if path.is_symlink():
        raise OSError(errno.ELOOP, "a link lies in its place", str(path))
    return open_regular(path)


def read_text(path: Path) -> str:
    """The text of a file of results. Raises OSError as `opened` does, or UnicodeDecodeError."""
    with opened(path) as file:
        return file.read().decode()


def read_json(path: Path) -> Any:
    """The value of a JSON file, see `agents.schema.parsed`. Raises OSError, or ValueError."""
    return parsed(read_text(path))


def not_followed(name: str, flags: int) -> int:
    """For `open(..., opener=)`: OSError where a link lies in the place of the file, or a pipe without a reader."""
    return os.open(name, flags | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0), 0o666)


def made(folder: Path) -> Path:
    """A folder to write in, which is made if it is missing. Raises OSError where a link lies in its place."""
    folder.mkdir(parents=True, exist_ok=True)
    if folder.is_symlink():
        raise OSError(errno.ENOTDIR, "a link lies in its place", str(folder))
    return folder


def is_name(name: object) -> bool:
    """Whether this can be the name of a file in a folder, and leads nowhere else."""
    return (
        isinstance(name, str)
        and name == Path(name).name
        and name.isprintable()
        and name not in ("", ".", "..")
    )


def write_file(path: Path, data: bytes) -> None:
    """Write a file atomically, see `agents.files.atomic`."""
    with atomic(path) as file:
        file.write(data)


def write_json(path: Path, value: Any) -> None:
    """Write a value as readable JSON, atomically."""
    write_file(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


@contextmanager
def alone(directory: Path) -> Iterator[None]:
    """Wait until nobody else holds this directory, and hold it; a file system without such locks lets everybody in."""
    lock = FileLock(directory / ".lock", fallback_to_soft=False)
    with suppress(OSError):
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
