"""The replay memory."""

from __future__ import annotations

import numpy as np
import torch

from agents.replay import Replay


def filled(capacity: int, count: int) -> Replay:
    replay = Replay(capacity, (2, 2))
    for i in range(count):
        replay.add(np.full((2, 2), i), i % 3, i / 10, np.full((2, 2), i + 1), terminated=i % 5 == 4)
    return replay


def test_the_oldest_transition_makes_room() -> None:
    replay = filled(10, 13)
    assert len(replay) == 10
    assert sorted(replay.arrays["observations"][:, 0, 0]) == list(range(3, 13))


def test_sampling_is_uniform_over_what_is_stored() -> None:
    batch = filled(50, 20).sample(np.random.default_rng(0), 20_000)
    counts = np.bincount(batch.observations[:, 0, 0].int(), minlength=20)
    assert len(counts) == 20
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


def test_a_batch_holds_whole_transitions() -> None:
    batch = filled(10, 13).sample(np.random.default_rng(0), 30)
    number = batch.observations[:, 0, 0]
    assert torch.equal(batch.next_observations[:, 1, 1], number + 1)
    assert torch.equal(batch.actions, number.long() % 3)
    torch.testing.assert_close(batch.rewards, number / 10)
    assert torch.equal(batch.terminated, (number % 5 == 4).float())
