"""Learners from elsewhere beside our arms, on highway-env's own physics (the replica) and the same test scenarios.

    python experiments/learners.py --out results/other-learners

Stable-Baselines3's DQN and PPO with the settings of highway-env's examples, and our DQN with rl-agents' settings, learn
in regular traffic for as many environment steps as our agents. Agents that a sweep has left in the directory are not
trained again. The same command goes on where it was stopped. It prints a table for each task, and writes the means of
each training to trainings.parquet.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import os
from collections.abc import Callable, Iterable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import pandas as pd
import tyro
from rich.console import Console

from experiments import sweep
from experiments.backends import make_env
from experiments.study.arms import training_seed
from experiments.study.executors import cores
from experiments.study.executors.local import call_all
from experiments.study.experiment import Experiment
from experiments.study.fingerprint import check_dynamics
from experiments.study.grid import Cell, choose_tasks, env_config
from experiments.study.presets import complete
from experiments.study.run import LOG
from experiments.study.store import EPISODES, Store
from experiments.support.errors import run_command, writing
from experiments.support.files import write_file

OURS = ("control", "treatment", "mixed")
# highway-env's own examples, scripts/sb3_highway_dqn.py and sb3_highway_ppo.py (there in six environments at once).
NETWORK = {"policy_kwargs": {"net_arch": [256, 256]}, "learning_rate": 5e-4, "gamma": 0.8}
REPLAY = {"buffer_size": 15_000, "learning_starts": 200, "batch_size": 32}
STABLE_BASELINES: dict[str, dict[str, Any]] = {
    "sb3-dqn": {**NETWORK, **REPLAY, "train_freq": 1, "target_update_interval": 50},
    "sb3-ppo": {**NETWORK, "n_steps": 768, "batch_size": 64, "n_epochs": 10},
}
# Settings of rl-agents' files on networks of this project, the paper's dueling network and ego attention:
# HighwayEnv/agents/DQNAgent/dueling_ddqn.json and IntersectionEnv/agents/DQNAgent/ego_attention_2h.json. The clip of
# the gradient's norm and the random steps before the first update are this project's.
RL_AGENTS: dict[str, dict[str, Any]] = {
    "rl-agents-dueling": {"network": "dueling", "gamma": 0.8, "batch_size": 32, "target_interval": 50},
    "rl-agents-attention": {"network": "attention", "gamma": 0.95, "batch_size": 64, "target_interval": 512},
}
EXPLORATION = {"rl-agents-dueling": 6000, "rl-agents-attention": 15_000}  # time constant [steps]
WARM_UP = 200
SHARED = {
    "steps_per_update": 1,
    "learning_rate_final": 5e-4,
    "tau": 1.0,
    "replay_capacity": 15_000,
    "warm_up": WARM_UP,
    "standardise": False,
    "epsilon_final": 0.05,
}
MEASURES = {"crashed": "crash rate", "stopped": "standing", "mean_speed": "speed [m/s]", "return": "return"}
TRAININGS = "trainings.parquet"  # the means of each
BY = ["task", "learner", "traffic"]


@dataclass(frozen=True)
class Options:
    """Train what is missing, and print the table."""

    out: Path = Path("results/other-learners")
    """Directory for the results."""
    backend: str = "replica"
    """Simulator: replica, sumo or highway-env."""
    preset: str = "second"
    """Preset of our agents, whose environment steps, seeds and scenarios are those of all."""
    tasks: tuple[str, ...] = ("highway", "two-way", "roundabout", "intersection", "u-turn")
    """Tasks, in their lightest traffic."""
    seeds: int = 3
    """Trainings of each."""
    episodes: int | None = None
    """Test scenarios in each traffic; by default the preset's."""
    workers: int | None = None
    """Processes; by default one for each core."""


def ours(options: Options, task: str, policies: Iterable[Path] = ()) -> Experiment:
    """Our arms, and policies of files."""
    return complete(
        Experiment(
            backend=options.backend,
            preset=options.preset,
            tasks=(task,),
            levels=(1,),
            seeds=options.seeds,
            episodes=options.episodes,
            arms=OURS,
            policy=tuple(map(str, policies)),
        )
    )


def environment_steps(options: Options, task: str) -> int:
    """Of one training."""
    profile = ours(options, task).profile(task)
    return int(profile["warm_up"] + profile["steps_per_update"] * profile["updates"])


def models(options: Options, task: str) -> dict[Path, Callable[[], None]]:
    """Files of the models of Stable-Baselines3, and what trains each."""
    first, steps = ours(options, task).first_seed, environment_steps(options, task)
    return {
        file: partial(train_model, file, learner, options.backend, task, seed, steps)
        for learner in STABLE_BASELINES
        for seed in range(first, first + options.seeds)
        for file in [options.out / "models" / f"{learner}-{task}-{options.backend}-{steps}-s{seed}.zip"]
    }


def train_model(file: Path, learner: str, backend: str, task: str, seed: int, steps: int) -> None:
    """Train a model of Stable-Baselines3 and write its file."""
    import stable_baselines3

    algorithm = getattr(stable_baselines3, learner.removeprefix("sb3-").upper())
    with closing(make_env(backend, task, env_config(backend, task, 1))) as env:
        settings = {**STABLE_BASELINES[learner], "seed": training_seed(task, 1, seed), "device": "cpu"}
        model = algorithm("MlpPolicy", env, **settings).learn(steps)
    file.parent.mkdir(parents=True, exist_ok=True)
    model.save(part := file.with_suffix(".part.zip"))
    os.replace(part, file)


def cells(options: Options, task: str) -> list[Cell]:
    """All tests with the other trainings; policies that do not learn stand beside."""
    experiment = ours(options, task, models(options, task))
    found, updates = experiment.cells(), environment_steps(options, task) - WARM_UP
    for name, settings in RL_AGENTS.items():
        learner = {**SHARED, **settings, "updates": updates, "epsilon_decay": EXPLORATION[name] / updates}
        other = replace(experiment, preset=name, arms=("control",), policy=(), learners={task: learner})
        found += [cell for cell in other.cells() if cell.kind == "agent"]
    return found


def learner_of(cell: Cell) -> str:
    """Who drives in a cell."""
    label = cell.profile["preset"]
    return label if label in RL_AGENTS else cell.arm or cell.policy.partition(f"-{cell.task}-")[0]


def trainings(directory: Path, tested: Iterable[Cell]) -> pd.DataFrame:
    """Means of MEASURES over the episodes of each cell, by BY."""
    store = Store(directory)
    episodes = pd.concat(
        store.tables(cell.name)[EPISODES].assign(task=cell.task, learner=learner_of(cell), training=cell.name)
        for cell in tested
    )
    return episodes.groupby([*BY, "training"], sort=False)[list(MEASURES)].mean()


def table(found: pd.DataFrame) -> pd.DataFrame:
    """MEASURES as text by task, driver and traffic: means over the trainings, and their standard error."""
    groups = found.rename(columns=MEASURES).groupby(BY, sort=False)
    errors = groups.sem().map(lambda error: "" if pd.isna(error) else f" ± {error:.2f}")
    return (groups.mean().map("{:.2f}".format) + errors).unstack("traffic")


def compare(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    tasks = choose_tasks(options.tasks)
    check_dynamics((options.backend, task) for task in tasks)
    every = {file: train for task in tasks for file, train in models(options, task).items()}
    missing = {file.name: train for file, train in every.items() if not file.exists()}
    with writing(options.out):
        call_all(missing, options.workers or cores(), "Stable-Baselines3", Console())
        work = [cell for task in tasks for cell in cells(options, task)]
        failures = sweep.compute(work, options.out, workers=options.workers)
    for name, reason in failures.items():
        print(f"{name} failed: {reason}; log: {Store(options.out).work / name / LOG}", file=sys.stderr)
    found = trainings(options.out, [cell for cell in work if cell.name not in failures])
    with writing(options.out):
        write_file(options.out / TRAININGS, found.reset_index().to_parquet(index=False))
    for task, rows in table(found).groupby("task", sort=False):
        print(f"\n{task}\n{rows.droplevel('task').to_string()}")
    return 1 if failures else 0


if __name__ == "__main__":
    run_command(lambda: compare(tyro.cli(Options, description=__doc__)), resumes=True)
