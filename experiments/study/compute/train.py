"""Training of one cell: its learner in the cell's traffic, by the rules of the training."""

from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pandas as pd

from agents.learner import Trained
from agents.plugins import foreign
from agents.streams import episode_seed
from experiments.backends import MakeEnv
from experiments.study.compute.policies import check
from experiments.study.compute.wrappers import TrainingEnv, observed
from experiments.study.design.arms import EVERY_ARM, training_seed
from experiments.study.design.cell import Cell, learner_of
from experiments.study.design.sheet import task_of
from experiments.support.errors import in_words
from experiments.support.files import plain_json

CURVE = 20  # parts of a learning curve


def train_cell(
    cell: Cell, make_env: MakeEnv, progress: Callable[[int], None] = lambda _: None
) -> tuple[Trained, pd.DataFrame, dict[str, Any]]:
    """Train the agent of a cell; the same whenever it is done.

    Args:
        progress: called now and then with the number of environment steps that are made.

    Returns:
        The agent, its training episodes (one row each), and "learner" of cell.json: the learner's own record, in which
        a number that is not finite is null, episodes (their number) and curve (see `learning_curve`).

    Raises:
        UserError: the user's file is not named, not there or has changed, or a setting makes no sense.
    """
    learner, settings = learner_of(cell.key(), cell.source)
    seed = training_seed(cell.task, cell.level, cell.seed or 0)
    if cell.source is not None:
        with in_words():
            check(cell.source, foreign(cell.source)[1], cell.profile)
    with ExitStack() as opened:  # an error in there is of this training alone
        make = partial(environments, cell, make_env, seed, opened)
        trained = learner.train(make, settings, seed, progress=progress)
    episodes = pd.DataFrame(trained.episodes)
    traffic = EVERY_ARM[str(cell.arm)].traffic
    if traffic.drawn:
        episodes["risk"] = [traffic.dose_of(episode_seed(seed, k)) for k in range(len(episodes))]
    curve = learning_curve(trained.episodes)
    return trained, episodes, {**plain_json(trained.record), "episodes": len(episodes), "curve": curve}


def environments(
    cell: Cell, make_env: MakeEnv, seed: int, opened: ExitStack, number: int | None = None
) -> gym.Env[Any, Any] | gym.vector.VectorEnv[Any, Any, Any]:
    """The environment of a training, or a vector environment of so many that share its episodes out.

    opened: closes them.
    """

    def one(first: int = 0, count: int = 1) -> gym.Env[Any, Any]:
        # a training clock may run longer than the test
        env = make_env(cell.backend, task_of(cell.task), {**cell.env_config, **cell.rules.duration})
        opened.enter_context(closing(env))
        traffic = EVERY_ARM[str(cell.arm)].traffic
        return TrainingEnv(observed(env, cell.rules), cell.rules, traffic, seed, first, count)

    if number is None:
        return one()
    return gym.vector.SyncVectorEnv([partial(one, first, number) for first in range(number)])


def learning_curve(episodes: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Means of the training episodes over equal parts of an agent's steps.

    Returns:
        step (at the end of each part), return and crashed (None where no episode ended).
    """
    steps = np.asarray(episodes["step"])
    edges = np.linspace(0, steps[-1] if len(steps) else 0, CURVE + 1)
    part = np.clip(np.searchsorted(edges, steps) - 1, 0, CURVE - 1)
    curve = pd.DataFrame({name: episodes[name] for name in ("return", "crashed")}, dtype=float)
    curve = curve.groupby(part).mean().reindex(range(CURVE)).round(6)
    return {
        "step": edges[1:].round().tolist(),
        **curve.astype(object).where(curve.notna(), None).to_dict("list"),
    }
