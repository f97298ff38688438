"""Learners from elsewhere beside ours, on highway-env's own physics (the replica) and the same test scenarios.

    python experiments/learners.py --out results/other-learners

Stable-Baselines3's DQN and PPO with the settings of highway-env's examples, and our DQN with rl-agents' settings, learn
in regular traffic for as many environment steps as our agents; each is a sweep of its own (`sweep.py --learner`).
Agents that a sweep has left in the directory are not trained again. It prints a table for each task, and writes the
means of each training to trainings.parquet. Those in results/other-learners were made at commit 842ea8e, where
Stable-Baselines3 drew its training scenarios itself.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd
import tyro

from experiments.study.compute.cells import compute
from experiments.study.design.experiment import Experiment
from experiments.study.design.fingerprint import check_dynamics
from experiments.study.design.grid import Cell, choose_tasks
from experiments.study.design.presets import complete
from experiments.study.results.store import EPISODES, Store
from experiments.study.results.working import LOG
from experiments.support.errors import run_command, writing
from experiments.support.files import write_file

OURS = ("control", "treatment", "mixed")
STABLE_BASELINES = ("sb3-dqn", "sb3-ppo")
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


def cells(options: Options, task: str) -> dict[str, list[Cell]]:
    """The trainings of each learner on a task by its name, and the policies that do not learn."""
    ours = complete(
        Experiment(
            backend=options.backend,
            preset=options.preset,
            tasks=(task,),
            levels=(1,),
            seeds=options.seeds,
            episodes=options.episodes,
            arms=OURS,
        )
    )
    found: dict[str, list[Cell]] = {}
    for cell in ours.cells():
        found.setdefault(cell.arm or cell.policy, []).append(cell)
    # Others train without our rules of training: their episodes end and pay as the environment's.
    steps = found["control"][0].budget[0]
    others = {name: replace(ours, learner=name, learners={task: {}}) for name in STABLE_BASELINES}
    others = {name: replace(own, settings=(f"steps={steps}",)) for name, own in others.items()}
    for name, settings in RL_AGENTS.items():
        updates = steps - WARM_UP
        learner = {**SHARED, **settings, "updates": updates, "epsilon_decay": EXPLORATION[name] / updates}
        others[name] = replace(ours, preset=name, learners={task: learner})
    for name, experiment in others.items():
        agents = replace(experiment, arms=("control",)).cells()
        found[name] = [cell for cell in agents if cell.kind == "agent"]
    return found


def trainings(directory: Path, tested: Mapping[str, Iterable[Cell]]) -> pd.DataFrame:
    """Means of MEASURES over the episodes of each cell, by BY.

    Args:
        tested: cells by who drives in them.
    """
    store = Store(directory)
    episodes = pd.concat(
        store.tables(cell.name)[EPISODES].assign(task=cell.task, learner=learner, training=cell.name)
        for learner, of_learner in tested.items()
        for cell in of_learner
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
    work: dict[str, list[Cell]] = {}
    for task in tasks:
        for learner, own in cells(options, task).items():
            work.setdefault(learner, []).extend(own)
    with writing(options.out):
        everything = [cell for own in work.values() for cell in own]
        failures = compute(everything, options.out, workers=options.workers)
    for name, reason in failures.items():
        print(f"{name} failed: {reason}; log: {Store(options.out).work / name / LOG}", file=sys.stderr)
    done = {learner: [cell for cell in own if cell.name not in failures] for learner, own in work.items()}
    found = trainings(options.out, done)
    with writing(options.out):
        write_file(options.out / TRAININGS, found.reset_index().to_parquet(index=False))
    for task, rows in table(found).groupby("task", sort=False):
        print(f"\n{task}\n{rows.droplevel('task').to_string()}")
    return 1 if failures else 0


if __name__ == "__main__":
    run_command(lambda: compare(tyro.cli(Options, description=__doc__)), resumes=True)
