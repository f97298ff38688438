"""Random streams keyed by (seed, purpose).

One stream a purpose, so that a draw more in one place (an extra exploration step, say) never shifts the draws
of another: an agent that behaves differently still meets the same training scenarios.
"""

import zlib

import numpy as np


def _sequence(seed: int, purpose: str, *numbers: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(entropy=seed, spawn_key=(zlib.crc32(purpose.encode()), *numbers))


def stream(seed: int, purpose: str) -> np.random.Generator:
    """The generator of one purpose, e.g. ``stream(3, "exploration")``. ValueError for a negative seed."""
    return np.random.default_rng(_sequence(seed, purpose))


def number(seed: int, purpose: str) -> int:
    """A seed in [0, 2**32) of one purpose, for a generator that is not numpy's. ValueError for a negative seed."""
    return int(_sequence(seed, purpose).generate_state(1)[0])


def episode_seed(seed: int, episode: int) -> int:
    """Seed of an agent's training episode, in [0, 2**32), a function of the two arguments alone.

    Two arms trained with one seed therefore meet the same scenarios in the same order.
    """
    return int(_sequence(seed, "training episode", episode).generate_state(1)[0])
