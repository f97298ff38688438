"""Trained agents in one file: what is stored is what is loaded, and a wrong name says which names there are."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

import agents
from agents import pretrained
from agents.checkpoint import CheckpointError
from agents.greedy import Greedy
from agents.models import EgoAttention, Standardised

SPACE = gym.spaces.Box(-np.inf, np.inf, (5, 7), np.float32)


def policy(seed: int) -> Greedy:
    torch.manual_seed(seed)
    return Greedy(Standardised(EgoAttention(SPACE, 3), SPACE))


@pytest.fixture
def file(tmp_path: Path) -> Path:
    about = {"network": "attention", "observations": [5, 7], "actions": 3, "time_observed": 0}
    stored = {
        "u-turn-3/mixed": ({**about, "precision": "float16"}, policy(0)),
        "u-turn-3/control": ({**about, "precision": "float32"}, policy(1)),
    }
    pretrained.save(stored, tmp_path / "agents.npz")
    return tmp_path / "agents.npz"


def test_full_precision_loads_the_very_weights(file: Path) -> None:
    assert agents.load("u-turn-3", "control", file).sha256 == policy(1).sha256


def test_half_precision_loads_the_weights_rounded(file: Path) -> None:
    loaded = agents.load("u-turn-3", "mixed", file).network.state_dict()
    for name, value in policy(0).network.state_dict().items():
        assert torch.equal(loaded[name], value.half().float()), name


def test_the_card_is_that_of_the_agent(file: Path) -> None:
    assert agents.card("u-turn-3", "mixed", file)["precision"] == "float16"
    assert set(agents.cards(file)) == {"u-turn-3/mixed", "u-turn-3/control"}


def test_an_unknown_agent_is_named_with_those_that_there_are(file: Path) -> None:
    with pytest.raises(ValueError, match=r"u-turn-3/mixd.*u-turn-3/mixed"):
        agents.load("u-turn-3", "mixd", file)


def test_a_damaged_file_is_an_error(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 255
    file.write_bytes(data)
    with pytest.raises(CheckpointError):
        agents.load("u-turn-3", "mixed", file)


def test_a_file_that_is_not_there_is_named_with_the_command_that_writes_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"agents\.npz: write it .* experiments\.study\.publish"):
        agents.load("u-turn-3", "mixed", tmp_path / "agents.npz")
