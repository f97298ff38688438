"""DQN and PPO of Stable-Baselines3 as learners, with the settings of highway-env's own examples."""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar

import gymnasium as gym
import torch
from torch import nn

from agents.episodes import Episodes
from agents.greedy import Greedy
from agents.learner import MakeEnv, Trained, check_numbers
from agents.models import WIDTH, EgoAttention

LEARNERS_OWN = {"steps", "hidden", "layers"}  # settings that are no arguments of the algorithm


@dataclass(frozen=True)
class Settings:
    """What highway-env's scripts/sb3_highway_dqn.py and sb3_highway_ppo.py have in common."""

    packages: ClassVar[tuple[str, ...]] = ("stable-baselines3",)
    steps: int = 20_000  # environment steps; of PPO rounded up to whole rollouts of n_steps
    hidden: int = 256  # width of the network's layers
    layers: int = 2
    learning_rate: float = 5e-4
    gamma: float = 0.8
    device: str = "cpu"

    def __post_init__(self) -> None:
        check_numbers(self)


@dataclass(frozen=True)
class DQNSettings(Settings):
    """Of Stable-Baselines3's DQN; the defaults are those of scripts/sb3_highway_dqn.py."""

    algorithm: ClassVar[str] = "DQN"
    buffer_size: int = 15_000
    learning_starts: int = 200
    batch_size: int = 32
    train_freq: int = 1
    target_update_interval: int = 50

    @property
    def updates(self) -> int:
        """Gradient updates of a training."""
        return max(self.steps - self.learning_starts, 0) // self.train_freq


@dataclass(frozen=True)
class PPOSettings(Settings):
    """Of Stable-Baselines3's PPO; the defaults are those of scripts/sb3_highway_ppo.py.

    There six environments make 128 steps each before an update, here one makes all.
    """

    algorithm: ClassVar[str] = "PPO"
    n_steps: int = 768
    batch_size: int = 64
    n_epochs: int = 10

    @property
    def updates(self) -> int:
        """Gradient updates of a training."""
        rollouts = -(-self.steps // self.n_steps)
        return rollouts * self.n_epochs * -(-self.n_steps // self.batch_size)


class Attention(nn.Module):
    """The study's attention before the layers of a policy of Stable-Baselines3: its ``features_extractor_class``.

    What a policy sees does not depend on the order of the other vehicles.
    """

    def __init__(self, space: gym.spaces.Box) -> None:
        super().__init__()
        self.features_dim = WIDTH  # Stable-Baselines3 asks for it
        self.network = EgoAttention(space, 1)
        self.network.decision.requires_grad_(False)  # the policy decides

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Features (batch, WIDTH) of observations (batch, vehicles, features)."""
        return self.network.features(x)


class Logits(nn.Module):
    """What a policy of Stable-Baselines3 acts by: the largest entry is its deterministic action."""

    def __init__(self, policy: Any) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Q-values, or logits of the actions."""
        if hasattr(self.policy, "q_net"):
            return self.policy.q_net(x)
        return self.policy.get_distribution(x).distribution.logits


class Unseeded(Episodes):
    """Stable-Baselines3 resets with a seed of its own, which is left out: the training's next episode begins."""

    def reset(self, **_: Any) -> tuple[Any, dict[str, Any]]:  # gymnasium's checker looks for this name
        """Begin the training's next episode."""
        return super().reset()


class StableBaselines3:
    """An algorithm of Stable-Baselines3."""

    def __init__(self, settings: type[Any]) -> None:
        self.Settings = settings

    def _model(self, env: gym.Env[Any, Any], settings: Any, seed: int | None) -> Any:
        import stable_baselines3

        torch.set_num_threads(1)  # the order of summation, hence the bits, depends on their number
        arguments = {name: value for name, value in asdict(settings).items() if name not in LEARNERS_OWN}
        policy = {"net_arch": [settings.hidden] * settings.layers}
        algorithm = getattr(stable_baselines3, settings.algorithm)
        return algorithm("MlpPolicy", env, policy_kwargs=policy, seed=seed, **arguments)

    def train(
        self,
        make_env: MakeEnv,
        settings: Any,
        seed: int,
        *,
        progress: Callable[[int], None] = lambda _: None,
    ) -> Trained:
        """See `agents.learner.Learner`."""
        env = Unseeded(make_env(), progress)
        model = self._model(env, settings, seed)
        model.learn(settings.steps)
        record = {"steps": int(model.num_timesteps), "updates": settings.updates}
        policy = Greedy(Logits(model.policy.cpu()).requires_grad_(False))
        return Trained(policy, env.columns(), record)

    def load(self, path: Path, settings: Any, env: gym.Env[Any, Any]) -> Greedy:
        """See `agents.learner.Learner`."""
        return Greedy.load(path, Logits(self._model(env, settings, None).policy))
