"""Files that are either there whole or not there at all, whatever is killed in between."""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from filelock import FileLock

from agents.files import atomic


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


def digest_of(value: Any) -> str:
    """Hexadecimal SHA-256 of a value, see `canonical_json`."""
    return sha256_bytes(canonical_json(value).encode())


def read_json(path: Path) -> Any:
    """The value of a JSON file. Raises OSError, or ValueError."""
    return json.loads(path.read_text(encoding="utf-8"))


def made(folder: Path) -> Path:
    """A folder to write in, which is made if it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def write_file(path: Path, data: bytes) -> None:
    """Write a file atomically, see `agents.files.atomic`."""
    with atomic(path) as file:
        file.write(data)


def write_json(path: Path, value: Any) -> None:
    """Write a value as readable JSON, atomically."""
    write_file(path, (json.dumps(value, indent=1, allow_nan=False) + "\n").encode())


def write_lines(path: Path, entries: Mapping[str, Any]) -> None:
    """Write values by name as JSON with a line for each, atomically."""
    lines = [f"{json.dumps(name)}: {json.dumps(one)}" for name, one in entries.items()]
    write_file(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


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
