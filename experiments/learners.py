"""Learners from elsewhere in the control arm's traffic, as a mark outside.

    python experiments/learners.py --out results/other-learners --beside results/standard

Each learner gets as many environment steps as the agents of the preset `standard` and is tested on the same scenarios.
The same command goes on where it was stopped.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import pandas as pd
import tyro

from agents.dqn import DQNConfig
from agents.policies import StableBaselines
from experiments.backends import make_env
from experiments.study.evaluate import Policy, evaluate
from experiments.study.grid import choose_tasks, env_config
from experiments.study.presets import PRESETS
from experiments.study.results import load
from experiments.study.seeds import training_seed
from experiments.support.errors import run_command, unknown
from experiments.support.files import write_file
from experiments.support.processes import end_with_parent

# highway-env's own example for Stable-Baselines3 (scripts/sb3_highway_dqn.py)
STABLE_BASELINES: dict[str, Any] = {
    "policy_kwargs": {"net_arch": [256, 256]},
    "learning_rate": 5e-4,
    "buffer_size": 15_000,
    "learning_starts": 200,
    "batch_size": 32,
    "gamma": 0.8,
    "train_freq": 1,
    "target_update_interval": 50,
}
# Settings of rl-agents' files on networks of this project, the paper's dueling network and ego attention:
# HighwayEnv/agents/DQNAgent/dueling_ddqn.json and IntersectionEnv/agents/DQNAgent/ego_attention_2h.json. The clip of
# the gradient's norm and the random steps before the first update are this project's.
WARM_UP = 200
RL_AGENTS = DQNConfig(
    steps_per_update=1,
    learning_rate_final=5e-4,
    tau=1.0,
    replay_capacity=15_000,
    warm_up=WARM_UP,
    standardise=False,
    epsilon_final=0.05,
)
OF_NETWORK: dict[str, dict[str, Any]] = {
    "dueling": {"gamma": 0.8, "batch_size": 32, "target_interval": 50},
    "attention": {"gamma": 0.95, "batch_size": 64, "target_interval": 512},
}
EXPLORATION = {"dueling": 6000, "attention": 15_000}  # time constant [steps]
LEARNERS = ("sb3", "rl-agents-dueling", "rl-agents-attention")


@dataclass(frozen=True)
class Options:
    """Train them where their results are missing, and print the table."""

    out: Path = Path("results/other-learners")
    """Directory for the results."""
    beside: Path | None = None
    """Results of a sweep whose control agents and policies stand in the table too."""
    tasks: tuple[str, ...] = ("highway", "two-way", "roundabout", "intersection", "u-turn")
    """Tasks, in their lightest traffic."""
    learners: tuple[str, ...] = LEARNERS
    """Of sb3, rl-agents-dueling, rl-agents-attention."""
    seeds: int = 3
    """Trainings of each."""
    steps: int | None = None
    """Environment steps; by default the preset's."""
    episodes: int = 100
    """Test scenarios in each traffic."""
    workers: int = os.cpu_count() or 1
    """Processes."""


@dataclass(frozen=True)
class Training:
    """One training with its test, whose result is a table of test episodes."""

    learner: str
    task: str
    seed: int
    steps: int
    episodes: int
    out: Path

    @property
    def file(self) -> Path:
        """The table of test episodes."""
        settings = f"{self.task}-{self.learner}-{self.steps}-{self.episodes}"
        return self.out / f"{settings}-s{self.seed}.parquet"

    def compute(self) -> None:
        """Train, test and write the table, unless it is there."""
        if self.file.exists():
            return
        env = make_env("sumo", self.task, env_config("sumo", self.task, 1))
        try:
            policy = self.train(env, training_seed(self.task, 1, self.seed))
            table = evaluate(env, policy, self.task, 1, self.episodes)
        finally:
            env.close()
        table = table.assign(task=self.task, learner=self.learner, seed=self.seed)
        write_file(self.file, table.to_parquet(index=False))

    def train(self, env: gym.Env[Any, Any], seed: int) -> Policy:
        """The policy that the learner finds."""
        if self.learner == "sb3":
            from stable_baselines3 import DQN

            model = DQN("MlpPolicy", env, seed=seed, device="cpu", **STABLE_BASELINES)
            model.learn(self.steps)
            model.save(self.file.with_suffix(".zip"))
            return StableBaselines(self.file.with_suffix(".zip"), env)
        from agents.training import train

        network = self.learner.removeprefix("rl-agents-")
        updates = self.steps - WARM_UP
        decay = EXPLORATION[network] / updates
        own = {"network": network, "updates": updates, "epsilon_decay": decay, **OF_NETWORK[network]}
        return train(env, replace(RL_AGENTS, **own), seed).policy


def trainings(options: Options) -> list[Training]:
    """What the options ask for. Raises UserError: a task or learner that does not exist."""
    for learner in options.learners:
        if learner not in LEARNERS:
            raise unknown("learner", learner, LEARNERS)
    found = []
    for task in choose_tasks(options.tasks):
        config = PRESETS["standard"].profile(task)
        steps = options.steps or config["warm_up"] + config["steps_per_update"] * config["updates"]
        found += [
            Training(learner, task, seed, steps, options.episodes, options.out)
            for seed in range(options.seeds)
            for learner in options.learners
        ]
    return found


def table(trained: list[Training], beside: Path | None) -> pd.DataFrame:
    """Return and crash rate of every learner, agent and policy: means over the trainings, and their standard error."""
    parts = [pd.read_parquet(training.file) for training in trained]
    if beside is not None:
        known = load(beside).episodes
        known = known[(known["level"] == 1) & known["task"].isin({training.task for training in trained})]
        control, policies = known[known["arm"] == "control"], known[known["kind"] == "baseline"]
        parts += [control.assign(learner="tuned"), policies.assign(learner=policies["policy"], seed=0)]
    episodes = pd.concat(parts, ignore_index=True)
    means = episodes.groupby(["task", "learner", "seed", "traffic"])[["return", "crashed"]].mean()
    return means.groupby(["task", "learner", "traffic"]).agg(["mean", "sem"]).unstack("traffic")


def main() -> int:
    """Command line."""
    options = tyro.cli(Options, description=__doc__)
    wanted = trainings(options)
    options.out.mkdir(parents=True, exist_ok=True)
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.workers, spawn, initializer=end_with_parent) as pool:
        list(pool.map(Training.compute, wanted))
    print(table(wanted, options.beside).round(2).to_string())
    return 0


if __name__ == "__main__":
    run_command(main)
