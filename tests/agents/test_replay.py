"""The replay memory."""

from __future__ import annotations

import numpy as np
import pytest

from agents.replay import Replay


def filled(capacity: int, count: int) -> Replay:
    replay = Replay(capacity, 4)
    for i in range(count):
        replay.add(np.full((2, 2), i), i % 3, i / 10, np.full((2, 2), i + 1), terminated=i % 5 == 4)
    return replay


def test_the_oldest_transition_makes_room() -> None:
    replay = filled(10, 13)
    assert len(replay) == 10
    assert sorted(replay.observations[:, 0]) == list(range(3, 13))
    row = int(np.flatnonzero(replay.observations[:, 0] == 9)[0])
    np.testing.assert_array_equal(replay.next_observations[row], [10, 10, 10, 10])
    assert (replay.actions[row], replay.terminated[row]) == (0, 1)
    assert replay.rewards[row] == np.float32(0.9)


def test_sampling_is_uniform_over_what_is_stored() -> None:
    rows = filled(50, 20).sample(np.random.default_rng(0), 20_000)
    counts = np.bincount(rows, minlength=20)
    assert len(counts) == 20
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


def test_sampling_repeats_with_its_generator() -> None:
    first, second = (filled(9, 9).sample(np.random.default_rng(3), 50) for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_an_empty_replay_cannot_be_sampled() -> None:
    with pytest.raises(ValueError, match="empty replay"):
        Replay(5, 4).sample(np.random.default_rng(0), 1)


@pytest.mark.parametrize("count", [0, 7, 10, 23])
def test_state_round_trip(count: int) -> None:
    source, target = filled(10, count), Replay(10, 4)
    target.load_state_dict({name: array.copy() for name, array in source.state_dict().items()})
    for replay in (source, target):
        replay.add(np.full(4, -1), 0, 0, np.full(4, -2), True)
    for name, array in source.state_dict().items():
        np.testing.assert_array_equal(array, target.state_dict()[name])


def test_a_state_of_other_sizes_is_refused() -> None:
    with pytest.raises(ValueError, match=r"shape \(5, 4\), got \(8, 4\)"):
        Replay(5, 4).load_state_dict(filled(8, 9).state_dict())
    with pytest.raises(ValueError, match=r"shape \(3, 7\), got \(3, 4\)"):
        Replay(8, 7).load_state_dict(filled(8, 3).state_dict())
