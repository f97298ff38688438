"""Random streams are numpy's."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from sumo_env.streams import stream


@pytest.mark.parametrize("seed", [0, 1, 5, 2**31 - 1, 2**32 - 1, 2**32, 2**40 + 3, *range(100, 200)])
@pytest.mark.parametrize("purpose", ["scenario", "drivers", ""])
def test_a_stream_is_numpys_generator_of_seed_and_purpose(seed: int, purpose: str) -> None:
    expected = np.random.Generator(
        np.random.PCG64(np.random.SeedSequence((seed, zlib.crc32(purpose.encode()))))
    )
    ours = stream(seed, purpose)
    assert ours.bit_generator.state == expected.bit_generator.state
    np.testing.assert_array_equal(ours.normal(size=5), expected.normal(size=5))


def test_purposes_and_seeds_differ() -> None:
    first = [
        stream(seed, purpose).random() for seed in range(50) for purpose in ("scenario", "drivers", "spawns")
    ]
    assert len(set(first)) == 150
