"""The training loop: several agents share one environment, play whole episodes in turn and learn in between.

Agents influence each other in nothing: each has its own network, replay, random streams and scenarios, and
an agent gets the same bits alone and in company. They share the environment only because a process can hold
one simulator.

Checkpoints are taken between episodes, where the state of the simulator does not matter: every episode
begins with ``env.reset(seed=...)``. A training that is killed at any time and run again gives the bits of
an uninterrupted one.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from agents.dqn import DQN, DQNConfig
from agents.policy import GreedyPolicy
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
Q_MARGIN = 1.2  # values may overshoot what the rewards allow by a fifth before the agent counts as diverged


@dataclass(frozen=True)
class ProbeQ:
    """A look at the Q-values on an agent's probe observations: the sign by which divergence is seen.

    mean and largest: of |max_a Q| over the observations. greedy_share: share of them in which the greedy
    action is the most common one (1 for a constant policy).
    """

    update: int
    mean: float
    largest: float
    greedy_share: float


@dataclass(frozen=True)
class TrainedAgent:
    """What training leaves behind. ``episodes``: one array a column of EPISODE_COLUMNS."""

    seed: int
    policy: GreedyPolicy
    episodes: dict[str, np.ndarray]
    probe_q: list[ProbeQ]
    updates: int
    steps: int
    max_abs_reward: float
    q_bound: (
        float  # no true value can be larger than max_abs_reward / (1 - gamma); this is Q_MARGIN times that
    )

    @property
    def diverged(self) -> bool:
        """Whether some probe value was ever beyond the bound, or no number at all."""
        return not all(look.largest <= self.q_bound for look in self.probe_q)


@dataclass(frozen=True)
class Progress:
    """How far a training is; passed to the callback after every block of updates."""

    updates: int
    budget: int
    episodes: tuple[int, ...]  # played so far, by agent
    mean_return: tuple[float, ...]  # over the last 20 episodes, by agent


class _Student:
    """One agent in training, with everything that is written down about it."""

    def __init__(
        self,
        config: DQNConfig,
        inputs: int,
        actions: int,
        seed: int,
        options: dict[str, Any] | None,
        probe: np.ndarray | None,
    ) -> None:
        self.config = config
        self.dqn = DQN(config, inputs, actions, seed)
        self.options = options
        self.probe = probe
        self.steps = 0
        self.max_abs_reward = 0.0
        self.log: dict[str, list[Any]] = {name: [] for name in EPISODE_COLUMNS}
        self.looks: list[ProbeQ] = []

    def play(self, env: gym.Env[Any, Any], steps: int) -> None:
        """Play whole episodes until the agent has made at least so many steps in all."""
        while self.steps < steps:
            self._play_episode(env)

    def _play_episode(self, env: gym.Env[Any, Any]) -> None:
        episode = len(self.log["episode"])
        observation, _ = env.reset(seed=episode_seed(self.dqn.seed, episode), options=self.options)
        rewards, speeds = [], []
        ended = False
        while not ended:
            action = self.dqn.act(observation, self.config.epsilon(self.steps))
            after, reward, terminated, truncated, info = env.step(action)
            self.dqn.replay.add(observation, action, float(reward), after, bool(terminated))
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
            "epsilon": self.config.epsilon(self.steps),
        }
        for name, value in row.items():
            self.log[name].append(value)

    def look(self) -> None:
        """Note the Q-values on the probe: the observations given by the caller, or the agent's first ones."""
        if self.probe is None:
            count = min(self.config.probe_size, len(self.dqn.replay))
            self.probe = self.dqn.replay.observations[:count].copy()
        q = np.array([self.dqn.q(observation) for observation in self.probe])
        size = np.abs(q.max(1))
        share = np.bincount(q.argmax(1)).max() / len(q)
        self.looks.append(ProbeQ(self.dqn.updates, float(size.mean()), float(size.max()), float(share)))

    def result(self) -> TrainedAgent:
        return TrainedAgent(
            seed=self.dqn.seed,
            policy=self.dqn.policy(),
            episodes={name: np.array(self.log[name], dtype) for name, dtype in EPISODE_COLUMNS.items()},
            probe_q=list(self.looks),
            updates=self.dqn.updates,
            steps=self.steps,
            max_abs_reward=self.max_abs_reward,
            q_bound=Q_MARGIN * self.max_abs_reward / (1.0 - self.config.gamma),
        )

    def state_dict(self) -> dict[str, np.ndarray]:
        state = {f"dqn.{name}": array for name, array in self.dqn.state_dict().items()}
        state |= {f"log.{name}": np.array(self.log[name], dtype) for name, dtype in EPISODE_COLUMNS.items()}
        state["looks"] = np.array([dataclasses.astuple(look) for look in self.looks]).reshape(-1, 4)
        state["steps"] = np.array(self.steps)
        state["max_abs_reward"] = np.array(self.max_abs_reward)
        if self.probe is not None:
            state["probe"] = self.probe
        return state

    def load_state_dict(self, state: Mapping[str, np.ndarray]) -> None:
        self.dqn.load_state_dict(
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
    seeds: Sequence[int],
    *,
    reset_options: Sequence[dict[str, Any] | None] | None = None,
    probe: np.ndarray | None = None,
    checkpoint: str | Path | None = None,
    checkpoint_interval: int = 1000,
    progress: Callable[[Progress], None] | None = None,
) -> list[TrainedAgent]:
    """Train one agent a seed, all of them on ``env``, for ``config.updates`` updates each.

    An agent plays whole episodes until it is ``config.block`` steps ahead of its updates (and
    ``config.warm_up`` more, from the start), then makes that many updates. So the budget is the same for
    all, in updates and, but for the end of the last episode, in steps.

    Args:
        env: observations are boxes of any shape, actions ``Discrete``; ``info`` may hold speed [m/s], crashed
            and arrived, which are logged. Every episode begins with ``reset(seed=..., options=...)``.
        config: the hyper-parameters, the same for all agents.
        seeds: one an agent; a seed may appear twice, with other options. Agents with one seed start with
            equal weights and meet the same scenarios.
        reset_options: what ``reset`` gets as ``options``, one entry an agent; None for no options.
        probe: observations (n, ...) on which Q-values are watched; by default each agent's first ones.
        checkpoint: file to write the state to and, if it is there, to go on from. It is left in place.
        checkpoint_interval: updates between two checkpoints; there is one at the end in any case.
        progress: called after every block of updates; what it raises ends the training.

    Raises:
        ValueError: no seed, a wrong number of reset options, or spaces that a DQN cannot handle.
        CheckpointError: the checkpoint is damaged or was written by a training with other settings.
    """
    options = list(reset_options) if reset_options is not None else [None] * len(seeds)
    inputs, actions = _sizes(env)
    if not seeds:
        raise ValueError("Training needs at least one seed: one agent is trained a seed.")
    if len(options) != len(seeds):
        raise ValueError(f"Give one reset option an agent: got {len(options)} for {len(seeds)} seeds.")
    if checkpoint_interval < 1:
        raise ValueError(f"checkpoint_interval must be at least 1, got {checkpoint_interval}.")
    students = [
        _Student(config, inputs, actions, int(seed), option, probe)
        for seed, option in zip(seeds, options, strict=True)
    ]
    settings = {
        **dataclasses.asdict(config),
        "seeds": [int(seed) for seed in seeds],
        "reset_options": options,
        "inputs": inputs,
        "actions": actions,
    }
    if checkpoint is not None:
        Path(checkpoint).parent.mkdir(parents=True, exist_ok=True)
        if Path(checkpoint).exists():
            _resume(Path(checkpoint), settings, students)
    while (updates := students[0].dqn.updates) < config.updates:
        block = min(config.block, config.updates - updates)
        done = updates + block
        for student in students:
            student.play(env, config.warm_up + done)
            for _ in range(block):
                student.dqn.update()
            if _due(updates, done, config.probe_interval) or done == config.updates:
                student.look()
        if checkpoint is not None and (_due(updates, done, checkpoint_interval) or done == config.updates):
            save_checkpoint(checkpoint, _state(settings, students))
        if progress is not None:
            progress(_progress(done, config.updates, students))
    return [student.result() for student in students]


def _due(before: int, after: int, interval: int) -> bool:
    return after // interval > before // interval


def _sizes(env: gym.Env[Any, Any]) -> tuple[int, int]:
    """Length of the flattened observation, and number of actions."""
    observations, actions = env.observation_space, env.action_space
    if not isinstance(observations, gym.spaces.Box) or not isinstance(actions, gym.spaces.Discrete):
        raise ValueError(
            f"A DQN needs Box observations and Discrete actions, got {observations} and {actions}."
        )
    if actions.start != 0:
        raise ValueError(f"The actions must be numbered from 0, got {actions}.")
    return int(np.prod(observations.shape)), int(actions.n)


def _progress(updates: int, budget: int, students: Sequence[_Student]) -> Progress:
    returns = [student.log["return"] for student in students]
    return Progress(
        updates=updates,
        budget=budget,
        episodes=tuple(len(values) for values in returns),
        mean_return=tuple(float(np.mean(values[-20:])) for values in returns),
    )


def _state(settings: Mapping[str, Any], students: Sequence[_Student]) -> dict[str, np.ndarray]:
    state = {"settings": np.array(json.dumps(settings))}
    for number, student in enumerate(students):
        state |= {f"agent{number}.{name}": array for name, array in student.state_dict().items()}
    return state


def _resume(path: Path, settings: Mapping[str, Any], students: Sequence[_Student]) -> None:
    state = load_checkpoint(path)
    if "settings" not in state:
        raise CheckpointError(f"{path} is no checkpoint of a training.")
    stored, wanted = json.loads(str(state["settings"])), json.loads(json.dumps(settings))
    differing = [
        f"{name} {stored.get(name)!r} instead of {wanted.get(name)!r}"
        for name in sorted({*stored, *wanted})
        if stored.get(name) != wanted.get(name)
    ]
    if differing:
        raise CheckpointError(
            f"The checkpoint {path} was written with {', '.join(differing)}. "
            "Use the same settings, or delete it to train from the start."
        )
    for number, student in enumerate(students):
        prefix = f"agent{number}."
        student.load_state_dict({k.removeprefix(prefix): v for k, v in state.items() if k.startswith(prefix)})
