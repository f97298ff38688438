"""Files that are whole or absent, whatever is killed; arrays in an npz, of which damage is detected when read."""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

import numpy as np


class DamagedFile(RuntimeError):
    """A file is damaged, or holds what nothing here has written."""


def sync(path: Path) -> None:
    """Bring a file, or the entries of a directory, to the disk (fsync)."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def atomic(path: Path) -> Iterator[BinaryIO]:
    """A file to be written in the place of ``path``: readers see the old content or all of the new one.

    Raises OSError when the directory cannot be written or the disk is full; the old content stays.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)
        if isinstance(error, OSError) and error.errno is not None:
            error.filename = str(path)
        raise
    sync(path.parent)  # makes the new name durable, too


def save_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays to ``path``; a process killed at any moment leaves the old file or the new one.

    Not compressed: that would take twenty times as long and save little. An npz keeps a CRC-32 of every
    array.
    """
    with atomic(Path(path)) as file:
        np.savez(file, allow_pickle=False, **arrays)


def load_arrays(path: str | Path, begins: str = "") -> dict[str, np.ndarray]:
    """Read what :func:`save_arrays` wrote: the arrays whose names begin so, by default all.

    Raises DamagedFile when the file is damaged, FileNotFoundError when there is none.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            # reads each to its end: checks its CRC-32; an entry that is no array is bytes
            return {name: np.asarray(archive[name]) for name in archive.files if name.startswith(begins)}
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged archive may end in nearly any of them
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise DamagedFile(
            f"{path} is damaged ({reason}): restore it from a copy, or delete it and make it again."
        ) from error
