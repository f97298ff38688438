"""The training of a double DQN: whole episodes, then as many updates as their steps allow.

Checkpoints are taken between episodes, where the state of the simulator does not matter: every episode begins with
``env.reset(seed=...)``. A training that is killed at any time and run again gives the bits of an uninterrupted one.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from agents.checkpoint import CheckpointError, load_arrays, save_arrays
from agents.dqn import DQN, DQNConfig
from agents.episodes import COLUMNS, Episodes
from agents.learner import RESUMED, UNINTERRUPTED, Trained
from agents.schema import parsed
from agents.streams import episode_seed

CHECKPOINTS = 20  # a training is checkpointed about so often
MIN_INTERVAL = 100  # updates between two checkpoints at least


class Training:
    """One agent in training, with everything that is written down about it.

    Attributes:
        probe: the agent's first observations, on which its Q-values are watched.
        probe_q: rows of update, mean and largest of max_a |Q| on the probe: the signs of divergence.
    """

    def __init__(self, agent: DQN, env: gym.Env[Any, Any]) -> None:
        self.agent, self.env = agent, Episodes(env)
        self.max_abs_reward = 0.0
        self.probe: np.ndarray | None = None
        self.probe_q: list[list[float]] = []

    def play(self, steps: int) -> None:
        """Play whole episodes until the agent has made at least so many steps in all."""
        while self.env.steps < steps:
            self._play_episode()

    def _play_episode(self) -> None:
        observation, _ = self.env.reset(seed=episode_seed(self.agent.seed, len(self.env.rows["episode"])))
        ended = False
        while not ended:
            action = self.agent.act(observation, self.agent.config.epsilon(self.env.steps))
            after, reward, terminated, truncated, _ = self.env.step(action)
            self.agent.replay.add(observation, action, float(reward), after, bool(terminated))
            observation, ended = after, terminated or truncated
            self.max_abs_reward = max(self.max_abs_reward, abs(float(reward)))

    def watch(self) -> None:
        """Note the Q-values on the probe."""
        if self.probe is None:
            self.probe = self.agent.replay.first(self.agent.config.probe_size)
        size = np.abs(self.agent.q(self.probe)).max(1)
        self.probe_q.append([self.agent.updates, float(size.mean()), float(size.max())])

    def trained(self, interruption: str) -> Trained:
        """What is left when it is over."""
        record = {
            "steps": self.env.steps,
            "updates": self.agent.updates,
            "interruption": interruption,
            "probe_q": self.probe_q,
            "q_bound": self.max_abs_reward / (1.0 - self.agent.config.gamma),
        }
        return Trained(self.agent.policy(), self.env.columns(), record)

    def state_dict(self) -> dict[str, np.ndarray]:
        """Everything that the future depends on, as arrays."""
        state = {f"dqn.{name}": array for name, array in self.agent.state_dict().items()}
        state |= {f"log.{name}": column for name, column in self.env.columns().items()}
        state["looks"] = np.array(self.probe_q, dtype=float).reshape(-1, 3)
        state["steps"] = np.array(self.env.steps)
        state["max_abs_reward"] = np.array(self.max_abs_reward)
        if self.probe is not None:
            state["probe"] = self.probe
        return state

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        """Put back a state. Raises ValueError when it cannot be one of this training."""
        lengths = state["log.length"]
        fits = {name: np.isfinite(array).all() for name, array in state.items() if array.dtype.kind == "f"}
        fits["log.mean_speed"] = True  # of environments that tell no speed
        limits = {
            "replay.actions": self.agent.actions,
            "replay.terminated": 2,
            "updates": self.agent.config.updates + 1,
        }
        for name, limit in limits.items():
            fits[f"dqn.{name}"] = np.isin(state[f"dqn.{name}"], np.arange(limit)).all()
        for name in COLUMNS:
            fits[f"log.{name}"] = fits.get(f"log.{name}", True) and len(state[f"log.{name}"]) == len(lengths)
        fits["log.step"] = np.array_equal(state["log.step"], np.cumsum(lengths))
        fits["log.episode"] = np.array_equal(state["log.episode"], np.arange(len(lengths)))
        fits["steps"] = state["steps"] == state["dqn.replay.added"] == lengths.sum()
        if odd := [name for name, is_good in fits.items() if not is_good]:
            raise ValueError(f"{', '.join(odd)}: not as this training writes it")
        own = {k.removeprefix("dqn."): v for k, v in state.items() if k.startswith("dqn.")}
        self.agent.load_state_dict(own)
        self.env.rows = {name: state[f"log.{name}"].tolist() for name in COLUMNS}
        # checkpoints of earlier versions have a fourth column
        self.probe_q = [[int(update), mean, most] for update, mean, most, *_ in state["looks"].tolist()]
        self.env.steps = int(state["steps"])
        self.max_abs_reward = float(state["max_abs_reward"])
        self.probe = state.get("probe")


def train(
    env: gym.Env[Any, Any],
    config: DQNConfig,
    seed: int,
    *,
    checkpoint: Path | None = None,
    checkpoint_interval: int | None = None,
    progress: Callable[[int], None] = lambda _: None,
) -> Trained:
    """Train an agent on ``env`` for ``config.updates`` updates.

    It plays whole episodes until it has made ``config.warm_up`` steps and ``config.steps_per_update`` more for each
    update of the next block, then makes these updates. Torch is set to one thread for the whole process: the order of
    summation, hence the bits, depends on the number of threads, and processes do the parallel work.

    Args:
        env: observations are boxes of any shape, actions ``Discrete``; ``info`` may hold crashed, which
            is logged. Every episode begins with ``reset(seed=...)``.
        config: the settings.
        seed: agents with one seed start with equal weights and meet the same scenarios.
        checkpoint: file to write the state to and, if it is there, to go on from. It is left in place.
        checkpoint_interval: updates between two checkpoints, by default a twentieth of them all; there is one at the
            end in any case.
        progress: called with environment steps after every block of updates; what it raises ends the training.

    Raises:
        ValueError: spaces that a DQN cannot handle, or an unknown network.
        CheckpointError: the checkpoint is damaged or was written by a training with other settings.
    """
    interval = checkpoint_interval or max(config.updates // CHECKPOINTS, MIN_INTERVAL)
    torch.set_num_threads(1)
    agent = DQN(config, env.observation_space, env.action_space, seed)
    training, interruption = Training(agent, env), UNINTERRUPTED
    settings = {
        **dataclasses.asdict(config),
        "seed": seed,
        "observations": list(env.observation_space.shape or ()),
        "actions": agent.actions,
    }
    if checkpoint is not None:
        checkpoint.parent.mkdir(parents=True, exist_ok=True)
        if checkpoint.exists():
            _resume(checkpoint, settings, training)
            interruption = RESUMED
    while (updates := agent.updates) < config.updates:
        done = min(updates + config.block, config.updates)
        training.play(config.warm_up)
        if updates == 0 and config.standardise:
            agent.standardise()
        training.play(config.warm_up + config.steps_per_update * done)
        while agent.updates < done:
            agent.update()
        if _due(updates, done, config.probe_interval) or done == config.updates:
            training.watch()
        if checkpoint is not None and (_due(updates, done, interval) or done == config.updates):
            save_arrays(checkpoint, {"settings": np.array(json.dumps(settings)), **training.state_dict()})
        progress(config.warm_up + config.steps_per_update * done)
    return training.trained(interruption)


def _due(before: int, after: int, interval: int) -> bool:
    return after // interval > before // interval


def _resume(path: Path, settings: Mapping[str, Any], training: Training) -> None:
    state = load_arrays(path)
    try:
        stored, wanted = parsed(str(state["settings"])), json.loads(json.dumps(settings))
        stored = {"by_hand": False, **dict(stored)}  # which checkpoints of earlier versions do not have
    except (KeyError, ValueError, TypeError):
        raise CheckpointError(
            f"{path} is no checkpoint of a training: delete it to train from the start."
        ) from None
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
    try:
        training.load_state_dict(state)
    except Exception as error:  # of arrays that are missing, or of another kind or shape
        raise CheckpointError(
            f"{path} is damaged ({type(error).__name__}: {error}): delete it to train from the start."
        ) from error
