"""Named random streams: one independent generator for each purpose, so that no part shifts another's draws."""

from __future__ import annotations

import zlib
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.random.bit_generator import ISeedSequence
from numpy.typing import NDArray

from sumo_env.compiled import compiled

Words = NDArray[np.uint32]


def stream(seed: int, purpose: str) -> np.random.Generator:
    """Generator of the random numbers that `purpose` (for example ``"scenario"``) draws under `seed`.

    Two purposes never share numbers: changing how many numbers the drivers draw leaves the places of the
    cars as they were (common random numbers, see docs/decisions.md).

    It is ``np.random.default_rng((seed, number of the purpose))``, made in a fifth of the time.
    """
    number = _number(purpose)
    if not 0 <= seed < 2**32:
        return np.random.default_rng((seed, number))
    seeded: Any = _Seeded(seed, number)  # numpy's annotations forget that it takes any ISeedSequence
    return np.random.Generator(np.random.PCG64(seeded))


@lru_cache(maxsize=64)
def _number(purpose: str) -> int:
    return zlib.crc32(purpose.encode())


class _Seeded(ISeedSequence):
    """``np.random.SeedSequence((first, second))`` for a PCG64, which asks for four words of 64 bits."""

    def __init__(self, first: int, second: int) -> None:
        self._words = _state(first, second)

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[Any]:
        return self._words.view(dtype)[:n_words]


@compiled
def _hashed(value: np.uint32, factor: np.uint32, multiplier: np.uint32) -> tuple[np.uint32, np.uint32]:
    """A word, hashed, and the next factor (``hashmix`` of numpy's SeedSequence)."""
    value = np.uint32(value ^ factor)
    factor = np.uint32(factor * multiplier)
    value = np.uint32(value * factor)
    return np.uint32(value ^ (value >> np.uint32(16))), factor


@compiled
def _state(first: int, second: int) -> Words:
    """The state that ``np.random.SeedSequence((first, second))`` generates, shape (8,); two words of 32 bits.

    O'Neill's seed_seq_fe; numpy promises that it stays what it is.
    """
    pool = np.zeros(4, np.uint32)
    pool[0], pool[1] = first, second
    factor = np.uint32(0x43B0D7E5)
    for i in range(4):
        pool[i], factor = _hashed(pool[i], factor, np.uint32(0x931E8875))
    for source in range(4):
        for i in range(4):
            if i != source:
                mixed, factor = _hashed(pool[source], factor, np.uint32(0x931E8875))
                word = np.uint32(pool[i] * np.uint32(0xCA01F9DD) - mixed * np.uint32(0x4973F715))
                pool[i] = word ^ (word >> np.uint32(16))
    state = np.empty(8, np.uint32)
    factor = np.uint32(0x8B51F9DD)
    for i in range(8):
        state[i], factor = _hashed(pool[i % 4], factor, np.uint32(0x58F38DED))
    return state
