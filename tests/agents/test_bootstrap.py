"""The target network's values: those of a plain forward pass, to the same bits whenever they are computed."""

from __future__ import annotations

import numpy as np
import pytest

from agents.architecture import Architecture
from agents.bootstrap import TargetValues
from agents.network import Network
from agents.policy import q_values
from agents.replay import Replay

ARCHITECTURE = Architecture(25, 5)
CAPACITY, BATCH = 230, 100  # two whole blocks and a short one


def target(seed: int = 0) -> Network:
    network = Network(ARCHITECTURE)
    network.flat[:] = ARCHITECTURE.initial(np.random.default_rng(seed))
    return network


def add(replay: Replay, count: int) -> None:
    for _ in range(count):
        after = np.random.default_rng(replay.added).normal(size=25)
        replay.add(after, 0, 0.0, after, False)


def expected(network: Network, replay: Replay, rows: np.ndarray) -> np.ndarray:
    return np.array([q_values(ARCHITECTURE, network.layers, o) for o in replay.next_observations[rows]])


@pytest.mark.parametrize("lag", [500, 1])  # values are kept, and computed anew in each batch
def test_values_are_those_of_the_stored_next_observations(lag: int) -> None:
    network, replay = target(), Replay(CAPACITY, 25)
    values = TargetValues(network, replay, lag, BATCH)
    for count in (101, 20, 90, 60, 300):  # the replay fills, wraps, and is exchanged at once
        add(replay, count)
        rows = np.random.default_rng(count).integers(len(replay), size=BATCH)
        np.testing.assert_allclose(values.q(rows), expected(network, replay, rows), atol=1e-5)


def test_values_of_a_changed_network_are_computed_anew() -> None:
    network, replay = target(), Replay(CAPACITY, 25)
    values = TargetValues(network, replay, 500, BATCH)
    add(replay, 150)
    rows = np.arange(BATCH)
    before = values.q(rows).copy()
    network.flat[:] = target(seed=1).flat
    values.forget()
    np.testing.assert_allclose(values.q(rows), expected(network, replay, rows), atol=1e-5)
    assert np.abs(values.q(rows) - before).max() > 1e-2


def test_bits_do_not_depend_on_when_values_are_computed() -> None:
    network, replay = target(), Replay(CAPACITY, 25)
    gradually = TargetValues(network, replay, 500, BATCH)
    for count in (7, 93, 1, 19, 100, 45):
        add(replay, count)
        gradually.q(np.zeros(BATCH, np.int64))
    at_once = TargetValues(network, replay, 500, BATCH)
    rows = np.arange(CAPACITY)
    np.testing.assert_array_equal(gradually.q(rows), at_once.q(rows))


def test_a_stored_transition_is_evaluated_once(monkeypatch: pytest.MonkeyPatch) -> None:
    network, replay = target(), Replay(CAPACITY, 25)
    values = TargetValues(network, replay, 500, BATCH)
    evaluated: list[int] = []
    forward = Network.forward

    def counted(self: Network, observations: np.ndarray, activations: object) -> np.ndarray:
        evaluated.append(len(observations))
        return forward(self, observations, activations)  # type: ignore[arg-type]

    monkeypatch.setattr(Network, "forward", counted)
    add(replay, CAPACITY)
    for _ in range(5):
        values.q(np.arange(BATCH))
    assert evaluated == [100, 100, 30]
    add(replay, 1)  # in the first row, which belongs to the first block
    values.q(np.arange(BATCH))
    assert evaluated[3:] == [100]
