"""Files that are whole or absent: arrays in an npz, written atomically; damage is detected when read."""

from __future__ import annotations

import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np


class CheckpointError(RuntimeError):
    """A checkpoint is damaged, or belongs to another training."""


def save_arrays(path: str | Path, arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays to ``path``; a process killed at any moment leaves the old file or the new one.

    Not compressed: that would take twenty times as long and save little. An npz keeps a CRC-32 of every
    array.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.name}.tmp")  # always this name, so that leftovers do not pile up
    with open(temporary, "wb") as file:
        np.savez(file, allow_pickle=False, **arrays)
        file.flush()
        os.fsync(file.fileno())
    os.replace(temporary, path)
    directory = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(directory)  # makes the new name durable, too
    finally:
        os.close(directory)


def load_arrays(path: str | Path) -> dict[str, np.ndarray]:
    """Read what :func:`save_arrays` wrote.

    Raises CheckpointError when the file is damaged, FileNotFoundError when there is none.
    """
    with open(path, "rb") as file:
        try:
            with np.load(file, allow_pickle=False) as archive:
                return {
                    name: archive[name] for name in archive.files
                }  # reads to the end: checks every CRC-32
        except (zipfile.BadZipFile, zlib.error, ValueError, KeyError, EOFError, NotImplementedError) as error:
            raise CheckpointError(
                f"{path} is damaged ({error}): delete it and run the training again."
            ) from error
