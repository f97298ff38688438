"""The training loop: whole episodes, then as many updates as their steps allow.

Checkpoints are taken between episodes, where the state of the simulator does not matter: every episode begins with
``env.reset(seed=...)``. A training that is killed at any time and run again gives the bits of an uninterrupted one.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.checkpoint import CheckpointError, load_arrays, save_arrays
from agents.dqn import DQN, DQNConfig
from agents.greedy import Greedy
from agents.models import Network
from agents.streams import episode_seed

# One row a training episode. step: environment steps of the agent after the episode; return: undiscounted;
# mean_speed [m/s] is NaN when the environment reports no speed.
EPISODE_COLUMNS = {
    "episode": np.int64,
    "step": np.int64,
    "return": np.float64,
    "length": np.int64,
    "crashed": np.bool_,
    "arrived": np.bool_,
    "mean_speed": np.float64,
    "epsilon": np.float64,
}


@dataclass(frozen=True)
class ProbeQ:
    """A look at the Q-values on an agent's probe observations: the sign by which divergence is seen.

    mean and largest: of max_a |Q| over the observations. greedy_share: share of them in which the greedy action is the
    most common one (1 for a constant policy).
    """

    update: int
    mean: float
    largest: float
    greedy_share: float


@dataclass(frozen=True)
class TrainedAgent:
    """What training leaves behind. ``episodes``: one array a column of EPISODE_COLUMNS."""

    seed: int
    policy: Greedy
    episodes: dict[str, np.ndarray]
    probe_q: list[ProbeQ]
    updates: int
    steps: int
    max_abs_reward: float
    q_bound: float  # no true value can be larger: max_abs_reward / (1 - gamma)


class Training:
    """One agent in training, with everything that is written down about it."""

    def __init__(
        self, agent: DQN, env: gym.Env[Any, Any], options: dict[str, Any] | None, probe: np.ndarray | None
    ) -> None:
        self.agent, self.env, self.options, self.probe = agent, env, options, probe
        self.steps = 0
        self.max_abs_reward = 0.0
        self.log: dict[str, list[Any]] = {name: [] for name in EPISODE_COLUMNS}
        self.looks: list[ProbeQ] = []

    def play(self, steps: int) -> None:
        """Play whole episodes until the agent has made at least so many steps in all."""
        while self.steps < steps:
            self._play_episode()

    def _play_episode(self) -> None:
        config, episode = self.agent.config, len(self.log["episode"])
        observation, _ = self.env.reset(seed=episode_seed(self.agent.seed, episode), options=self.options)
        rewards, speeds = [], []
        ended = False
        while not ended:
            action = self.agent.act(observation, config.epsilon(self.steps))
            after, reward, terminated, truncated, info = self.env.step(action)
            self.agent.replay.add(observation, action, float(reward), after, bool(terminated))
            observation, ended = after, terminated or truncated
            self.steps += 1
            rewards.append(float(reward))
            speeds.append(float(info.get("speed", np.nan)))
        self.max_abs_reward = max(self.max_abs_reward, *map(abs, rewards))
        row = {
            "episode": episode,
            "step": self.steps,
            "return": sum(rewards),
            "length": len(rewards),
            "crashed": bool(info.get("crashed", False)),
            "arrived": bool(info.get("arrived", False)),
            "mean_speed": float(np.mean(speeds)),
            "epsilon": config.epsilon(self.steps),
        }
        for name, value in row.items():
            self.log[name].append(value)

    def look(self) -> None:
        """Note the Q-values on the probe: the observations given by the caller, or the agent's first ones."""
        if self.probe is None:
            self.probe = self.agent.replay.first(self.agent.config.probe_size)
        q = self.agent.q(self.probe)
        size = np.abs(q).max(1)
        share = np.bincount(q.argmax(1)).max() / len(q)
        self.looks.append(ProbeQ(self.agent.updates, float(size.mean()), float(size.max()), float(share)))

    def result(self) -> TrainedAgent:
        """What is left when it is over."""
        return TrainedAgent(
            seed=self.agent.seed,
            policy=self.agent.policy(),
            episodes={name: np.array(self.log[name], dtype) for name, dtype in EPISODE_COLUMNS.items()},
            probe_q=list(self.looks),
            updates=self.agent.updates,
            steps=self.steps,
            max_abs_reward=self.max_abs_reward,
            q_bound=self.max_abs_reward / (1.0 - self.agent.config.gamma),
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that the future depends on, as arrays."""
        state = {f"dqn.{name}": array for name, array in self.agent.state_dict().items()}
        state |= {f"log.{name}": np.array(self.log[name], dtype) for name, dtype in EPISODE_COLUMNS.items()}
        state["looks"] = np.array([dataclasses.astuple(look) for look in self.looks]).reshape(-1, 4)
        state["steps"] = np.array(self.steps)
        state["max_abs_reward"] = np.array(self.max_abs_reward)
        if self.probe is not None:
            state["probe"] = self.probe
        return state

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Put back a state."""
        self.agent.load_state_dict(
            {k.removeprefix("dqn."): v for k, v in state.items() if k.startswith("dqn.")}
        )
        self.log = {name: state[f"log.{name}"].tolist() for name in EPISODE_COLUMNS}
        self.looks = [ProbeQ(int(update), *rest) for update, *rest in state["looks"].tolist()]
        self.steps = int(state["steps"])
        self.max_abs_reward = float(state["max_abs_reward"])
        self.probe = state.get("probe")


def train(
    env: gym.Env[Any, Any],
    config: DQNConfig,
    seed: int,
    *,
    network: Network | None = None,
    reset_options: dict[str, Any] | None = None,
    probe: np.ndarray | None = None,
    checkpoint: str | Path | None = None,
    checkpoint_interval: int = 1000,
    progress: Callable[[int], None] | None = None,
) -> TrainedAgent:
    """Train an agent on ``env`` for ``config.updates`` updates.

    It plays whole episodes until it has made ``config.warm_up`` steps and ``config.steps_per_update`` more for each
    update of the next block, then makes these updates. Torch is set to one thread for the whole process: the order of
    summation, hence the bits, depends on the number of threads, and processes do the parallel work.

    Args:
        env: observations are boxes of any shape, actions ``Discrete``; ``info`` may hold speed [m/s], crashed
            and arrived, which are logged. Every episode begins with ``reset(seed=..., options=...)``.
        config: the settings.
        seed: agents with one seed start with equal weights and meet the same scenarios.
        network: a network class; by default the one that the config names.
        reset_options: what ``reset`` gets as ``options``.
        probe: observations (n, ...) on which Q-values are watched; by default the agent's first ones.
        checkpoint: file to write the state to and, if it is there, to go on from. It is left in place.
        checkpoint_interval: updates between two checkpoints; there is one at the end in any case.
        progress: called after every block of updates; what it raises ends the training.

    Raises:
        ValueError: spaces that a DQN cannot handle, or an unknown network.
        CheckpointError: the checkpoint is damaged or was written by a training with other settings.
    """
    if checkpoint_interval < 1:
        raise ValueError(f"checkpoint_interval must be at least 1, got {checkpoint_interval}.")
    torch.set_num_threads(1)
    agent = DQN(config, env.observation_space, env.action_space, seed, network)
    training = Training(agent, env, reset_options, probe)
    settings = {
        **dataclasses.asdict(config),
        "seed": seed,
        **({"reset_options": reset_options} if reset_options else {}),
        "observations": list(env.observation_space.shape or ()),
        "actions": agent.actions,
    }
    if checkpoint is not None:
        Path(checkpoint).parent.mkdir(parents=True, exist_ok=True)
        if Path(checkpoint).exists():
            _resume(Path(checkpoint), settings, training)
    while (updates := agent.updates) < config.updates:
        done = min(updates + config.block, config.updates)
        training.play(config.warm_up)
        if updates == 0 and config.standardise:
            agent.standardise()
        training.play(config.warm_up + config.steps_per_update * done)
        while agent.updates < done:
            agent.update()
        if _due(updates, done, config.probe_interval) or done == config.updates:
            training.look()
        if checkpoint is not None and (_due(updates, done, checkpoint_interval) or done == config.updates):
            save_arrays(checkpoint, {"settings": np.array(json.dumps(settings)), **training.state_dict()})
        if progress is not None:
            progress(done)
    return training.result()


def _due(before: int, after: int, interval: int) -> bool:
    return after // interval > before // interval


def _resume(path: Path, settings: Mapping[str, Any], training: Training) -> None:
    state = load_arrays(path)
    if "settings" not in state:
        raise CheckpointError(f"{path} is no checkpoint of a training.")
    stored, wanted = json.loads(str(state["settings"])), json.loads(json.dumps(settings))
    differing = [
        f"{name} {stored.get(name)!r} instead of {wanted[name]!r}"
        for name in sorted(wanted)  # a checkpoint of an earlier version may have more
        if stored.get(name) != wanted[name]
    ]
    if differing:
        raise CheckpointError(
            f"The checkpoint {path} was written with {', '.join(differing)}. "
            "Use the same settings, or delete it to train from the start."
        )
    training.load_state_dict(state)
