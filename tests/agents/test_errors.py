"""What agents refuse: a row is a call, and the word in its ValueError that says what to do."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents import load
from agents.dqn import DQNConfig, train
from agents.files import save_arrays
from agents.greedy import Greedy
from agents.learner import settings_of
from agents.learners import LEARNERS, learner
from agents.models import EgoAttention, network_class
from agents.plugins import load_object
from agents.policies import foreign_policy
from agents.rules import make_policy
from tests.agents.test_rules import road
from tests.experiments.fake_env import FakeEnv

ENV = FakeEnv("u-turn", {})
FILES = {
    "mine.py": "class Mine: pass\ndef nothing(env): return 3\ndef bare(): return 3\n",
    "wrong.py": "1 / 0\n",
}


class Fixed(torch.nn.Module):
    """A network that gives the same Q-values whatever it sees."""

    def __init__(self, *values: float) -> None:
        super().__init__()
        self.values = torch.tensor([values])

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        return self.values


def other(file: str) -> Path:
    """A file of arrays that are no weights of that network."""
    save_arrays(Path(file), {"weights": np.zeros(3)})
    return Path(file)


SETTINGS: list[tuple[dict[str, Any], str]] = [
    ({"gamma": 0.0}, "gamma must be a number above 0"),
    ({"gamma": 1.0}, "gamma must be below 1"),
    ({"max_grad_norm": math.nan}, "max_grad_norm must be a number above 0"),
    ({"target_interval": 2.5}, "target_interval must be a whole number"),
    ({"learning_rate": "fast"}, "learning_rate must be a number above 0"),
    ({"epsilon_final": 1.5}, "epsilon_final must be at most 1"),
    ({"standardise": 1}, "standardise must be true or false"),
]
CALLS: list[tuple[Callable[[], Any], str]] = [
    *((lambda setting=setting: DQNConfig(**setting), word) for setting, word in SETTINGS),
    *(
        (partial(settings_of, one.Settings, {"gama": 0.9}, name), f"'gama' of {name}: did you mean 'gamma'")
        for name, one in LEARNERS.items()
    ),
    *(
        (partial(settings_of, one.Settings, {"batch_size": wrong}, name), "batch_size")
        for name, one in LEARNERS.items()
        for wrong in (0, 2.5, "many")
    ),
    (lambda: learner("sb3-pp"), "did you mean 'sb3-ppo'"),
    (lambda: learner("mine.py:Mine"), "no Settings"),
    (lambda: train(gym.make("Pendulum-v1"), DQNConfig(), 0), "Box observations and Discrete actions"),
    (lambda: train(ENV, DQNConfig(network="none"), 0), "unknown network"),
    (lambda: load_object("slow"), "my_file.py:slow"),
    (lambda: network_class("transformer"), "known are attention, dueling, FILE:NAME"),
    (lambda: network_class("mine.py:Other"), "defines no Other"),
    (lambda: network_class("wrong.py:Mine"), "ZeroDivisionError"),
    (lambda: EgoAttention(gym.spaces.Box(-1, 1, (25,)), 5), "vehicles, features"),
    (lambda: make_policy("brave", road()), "known are"),
    (lambda: make_policy("faster", road({0: "IDLE", 1: "SLOWER"})), "FASTER"),
    (lambda: make_policy("careful", road(features=("presence", "x", "y", "vy"))), "no vx"),
    (lambda: foreign_policy("mine.py:nothing", ENV), "no act"),
    (lambda: foreign_policy("mine.py:bare", ENV), "one argument"),
    (lambda: load("u-turn-3", "contrl"), "u-turn-3/control"),
    (lambda: Greedy.load(other("other.npz"), Fixed(1.0, 0.9)), "another network"),
    (lambda: Greedy(Fixed(1.0, math.nan)).act(np.ones((2, 5), np.float32)), "not a finite number"),
]


@pytest.mark.parametrize(("call", "word"), CALLS, ids=[f"{k}-{row[1]}" for k, row in enumerate(CALLS)])
def test_a_call_is_refused(call: Callable[[], Any], word: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(ValueError) as caught:
        call()
    assert word in str(caught.value)
