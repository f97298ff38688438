"""Training of one cell: the learner of `agents` in the cell's traffic, resumed from its checkpoint if there is one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.dqn import DQNConfig
from agents.greedy import Greedy
from agents.models import network_class
from agents.streams import episode_seed
from agents.training import TrainedAgent, train
from experiments.study.arms import DRAWN, drawn_dose, training_seed
from experiments.study.grid import Cell
from experiments.study.policies import check
from experiments.study.wrappers import Training, observed
from experiments.support.errors import UserError

CHECKPOINT = "checkpoint.npz"
CURVE = 20  # parts of a learning curve
CHECKPOINTS = 20  # a training is checkpointed about so often
MIN_INTERVAL = 100  # updates between two checkpoints at least


@dataclass(frozen=True)
class Trained:
    """A trained agent as it is stored: policy, training episodes (one row each), and "learner" of cell.json."""

    policy: Greedy
    episodes: pd.DataFrame
    learner: dict[str, Any]


def learner_config(profile: Mapping[str, Any]) -> DQNConfig:
    """The settings of the learner among those of a profile. ValueError: one makes no sense."""
    names = {field.name for field in fields(DQNConfig)}
    return DQNConfig(**{name: value for name, value in profile.items() if name in names})


def train_cell(
    cell: Cell,
    env: gym.Env[Any, Any],
    directory: Path,
    progress: Callable[[int], None] = lambda _: None,
) -> Trained:
    """Train the agent of a cell; bit for bit the same however often it is interrupted.

    Args:
        env: an environment of the cell's task and level.
        directory: where the checkpoint lies, or is written.
        progress: called now and then with the number of updates that are made.

    Raises:
        CheckpointError: the checkpoint is damaged.
        UserError: the network does not fit.
        OSError: the checkpoint cannot be written.
    """
    config = learner_config(cell.profile)
    if cell.source is not None:
        check(cell.source, cell.profile["network_sha256"])
    seed = training_seed(cell.task, cell.level, cell.seed or 0)
    try:
        agent = train(
            Training(observed(env, cell.profile), cell.profile, cell.arm),
            config,
            seed,
            network=network_class(cell.source or config.network),
            reset_options={"config": {"risk": cell.risk}},
            checkpoint=directory / CHECKPOINT,
            checkpoint_interval=max(config.updates // CHECKPOINTS, MIN_INTERVAL),
            progress=progress,
        )
    except ValueError as error:
        raise UserError(str(error)) from None
    episodes = pd.DataFrame(agent.episodes)
    if cell.arm in DRAWN:
        episodes["risk"] = [drawn_dose(cell.arm, episode_seed(seed, k)) for k in episodes["episode"]]
    return Trained(agent.policy, episodes, learner_record(agent))


def learner_record(agent: TrainedAgent) -> dict[str, Any]:
    """What cell.json says of the learner.

    probe_q: [update, mean of max |Q|, largest |Q|] over the probe states. q_bound: the largest value that any policy
    can have, max |r| / (1 - gamma). curve: see `learning_curve`. A number that is not finite is null.
    """

    def finite(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    return {
        "updates": agent.updates,
        "steps": agent.steps,
        "episodes": len(agent.episodes["episode"]),
        "probe_q": [[look.update, finite(look.mean), finite(look.largest)] for look in agent.probe_q],
        "curve": learning_curve(agent.episodes),
        "q_bound": agent.q_bound,
        "weights_sha256": agent.policy.sha256,
    }


def learning_curve(episodes: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Means of the training episodes over equal parts of an agent's steps.

    Returns:
        step (at the end of each part), return and crashed (None where no episode ended).
    """
    steps = np.asarray(episodes["step"])
    edges = np.linspace(0, steps[-1], CURVE + 1)
    part = np.clip(np.searchsorted(edges, steps) - 1, 0, CURVE - 1)

    def mean(name: str) -> list[float | None]:
        values = np.asarray(episodes[name], dtype=float)
        return [
            round(float(values[part == k].mean()), 6) if (part == k).any() else None for k in range(CURVE)
        ]

    return {"step": edges[1:].round().tolist(), "return": mean("return"), "crashed": mean("crashed")}
