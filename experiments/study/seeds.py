"""Which scenarios are met: the test scenarios, and streams for what is not the traffic.

A scenario is a seed given to ``env.reset``. Training scenarios have seeds below 2**32 (`training_seed`,
`agents.streams.episode_seed`), test scenarios have seeds of 2**32 and above: the two sets are disjoint by
construction. A test scenario depends on the task, the level and its number alone, so all arms, training
seeds, policies and both simulators are tested on the same ones. Regular and risky tests share their seeds:
the same cars stand in the same places, with other drivers.
"""

from __future__ import annotations

import zlib

import numpy as np

TEST = 2**32  # where the seeds of the test scenarios begin


def scenario_seed(task: str, level: int, scenario: int, purpose: str = "test") -> int:
    """Seed of a scenario of a task and level, in [2**32, 2**33); the gates ("gate") have others than the test."""
    return TEST + stream_seed(f"{purpose} scenario", task, level, scenario)


def training_seed(task: str, level: int, seed: int) -> int:
    """The learner's seed of a training in [0, 2**32): one for both arms, others for each task, level and number.

    Agents of two settings that bear the same number therefore share no initial weights and no scenarios, and count
    as independent wherever settings are pooled.
    """
    return stream_seed("training", task, level, seed)


def stream_seed(purpose: str, *key: str | int) -> int:
    """Seed in [0, 2**32) that belongs to a purpose, for example a random policy's draws in one episode."""
    words = [zlib.crc32(word.encode()) if isinstance(word, str) else word for word in (purpose, *key)]
    return int(np.random.SeedSequence(words).generate_state(1)[0])
