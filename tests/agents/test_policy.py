"""Greedy policies: what they do, and that a file holds all of them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.architecture import Architecture
from agents.policy import GreedyPolicy

ARCHITECTURE = Architecture(15, 4, hidden=(16, 8), stream=(6,), head="sum")


def policy(seed: int = 0) -> GreedyPolicy:
    return GreedyPolicy(ARCHITECTURE, ARCHITECTURE.initial(np.random.default_rng(seed)))


def test_the_greedy_action_has_the_highest_value() -> None:
    for observation in np.random.default_rng(1).normal(size=(20, 5, 3)):
        assert policy().act(observation) == int(np.argmax(policy().q(observation)))


def test_saved_and_loaded_policies_are_equal(tmp_path: Path) -> None:
    policy().save(tmp_path / "weights")
    loaded = GreedyPolicy.load(tmp_path / "weights")
    assert loaded.architecture == ARCHITECTURE
    assert loaded.sha256 == policy().sha256 != policy(1).sha256
    policy().save(tmp_path / "again")
    assert (tmp_path / "again").read_bytes() == (tmp_path / "weights").read_bytes()


def test_weights_are_copied() -> None:
    vector = ARCHITECTURE.initial(np.random.default_rng(0))
    held = GreedyPolicy(ARCHITECTURE, vector)
    before = held.q(np.ones(15))
    vector[:] = 0
    np.testing.assert_array_equal(held.q(np.ones(15)), before)


def test_an_observation_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match=r"15 entries, got shape \(5, 5\)"):
        policy().act(np.zeros((5, 5)))


def test_a_file_without_a_network_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", numbers=np.arange(3))
    with pytest.raises(ValueError, match="holds no dueling network"):
        GreedyPolicy.load(tmp_path / "other.npz")


def test_acting_loads_no_torch() -> None:
    code = "import sys, agents.policy, agents.rules; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
