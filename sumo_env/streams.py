"""Named random streams: one independent generator for each purpose, so that no part shifts another's draws."""

import zlib

import numpy as np

Random = np.random.Generator


def stream(seed: int, purpose: str) -> Random:
    """Generator of the random numbers that `purpose` (for example ``"scenario"``) draws under `seed`.

    Two purposes never share numbers: changing how many numbers the drivers draw leaves the places of the
    vehicles as they were (common random numbers, see docs/developers/decisions.md).
    """
    return Random(np.random.PCG64(np.random.SeedSequence((seed, zlib.crc32(purpose.encode())))))
