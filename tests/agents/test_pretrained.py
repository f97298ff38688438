"""Trained agents in one file: what is stored is what is loaded, and a wrong name says which names there are."""

from __future__ import annotations

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

import agents
from agents import pretrained
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


@pytest.mark.parametrize(("arm", "seed", "precision"), [("mixed", 0, "float16"), ("control", 1, "float32")])
def test_an_agent_has_the_weights_that_were_stored_in_their_precision(file, arm, seed, precision) -> None:
    assert agents.card("u-turn-3", arm, file)["precision"] == precision
    loaded = agents.load("u-turn-3", arm, file).network.state_dict()
    for name, value in policy(seed).network.state_dict().items():
        assert torch.equal(loaded[name], value.to(getattr(torch, precision)).float()), name


def test_an_unknown_agent_is_named_with_those_that_there_are(file: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"u-turn-3/mixd.*u-turn-3/mixed"):
        agents.load("u-turn-3", "mixd", file)
    with pytest.raises(FileNotFoundError, match=r"none\.npz: write it .* experiments\.study\.publish"):
        agents.load("u-turn-3", "mixed", tmp_path / "none.npz")
