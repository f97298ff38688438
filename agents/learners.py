"""The learners by name."""

from pathlib import Path
from typing import Any

import gymnasium as gym

from agents.dqn import DQNConfig, greedy, train
from agents.greedy import Greedy
from agents.learner import Learner, MakeEnv, Trained
from agents.models import Standardised, network_class
from agents.plugins import named
from agents.sb3 import DQNSettings, PPOSettings, StableBaselines3


class DoubleDQN:
    """This project's double DQN (`agents.dqn`)."""

    Settings = DQNConfig

    def train(self, make_env: MakeEnv, settings: DQNConfig, seed: int, **kept: Any) -> Trained:
        """See `Learner`."""
        return train(make_env(), settings, seed, **kept)

    def load(self, path: Path, settings: DQNConfig, env: gym.Env[Any, Any]) -> Greedy:
        """See `Learner`."""
        space: Any = env.observation_space
        actions: Any = env.action_space
        network = network_class(settings.network)(space, int(actions.n))
        return greedy(settings).load(path, Standardised(network, space))


LEARNERS: dict[str, Learner] = {
    "dqn": DoubleDQN(),
    "sb3-dqn": StableBaselines3(DQNSettings),
    "sb3-ppo": StableBaselines3(PPOSettings),
}


def learner(name: str) -> Learner:
    """The learner of this name, or "FILE:NAME" for an object of a file of one's own.

    Raises ValueError when there is no such learner.
    """
    found = named("learner", name, LEARNERS)
    for part in ("Settings", "train", "load"):
        if not hasattr(found, part):
            raise ValueError(f"{name} is no learner: it has no {part} (agents/learner.py says what one has)")
    return found
