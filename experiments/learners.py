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

from experiments.support.threads import limit_threads

limit_threads()

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import tyro

from agents.dqn import DQNConfig
from agents.policies import StableBaselines
from experiments.analysis.gates import CONSTANT_POLICIES
from experiments.backends import make_env
from experiments.study.attempt import Beat
from experiments.study.evaluate import Policy, evaluate
from experiments.study.executors import open_executor
from experiments.study.fingerprint import dynamics
from experiments.study.grid import TASKS, env_config, level_names
from experiments.study.presets import get_preset
from experiments.study.results import load
from experiments.study.run import Observer, run
from experiments.study.seeds import training_seed
from experiments.study.wrappers import observed, trained_on
from experiments.support.errors import UserError, run_command, unknown
from experiments.support.files import canonical_json, sha256_bytes, write_file

if TYPE_CHECKING:
    import gymnasium as gym
    import pandas as pd

OURS = "tuned"
STABLE_BASELINES: dict[str, dict[str, Any]] = {
    # highway-env's own example for Stable-Baselines3 (scripts/sb3_highway_dqn.py)
    "sb3": {
        "policy_kwargs": {"net_arch": [256, 256]},
        "learning_rate": 5e-4,
        "buffer_size": 15_000,
        "learning_starts": 200,
        "batch_size": 32,
        "gamma": 0.8,
        "train_freq": 1,
        "target_update_interval": 50,
    },
    # RL Baselines3 Zoo has no DQN for highway-env; this is what it tuned for LunarLander-v3 (hyperparams/dqn.yml),
    # its nearest task: few continuous observations, four actions, crashes
    "sb3-zoo": {
        "policy_kwargs": {"net_arch": [256, 256]},
        "learning_rate": 6.3e-4,
        "buffer_size": 50_000,
        "learning_starts": 0,
        "batch_size": 128,
        "gamma": 0.99,
        "train_freq": 4,
        "gradient_steps": -1,
        "target_update_interval": 250,
        "exploration_fraction": 0.12,
        "exploration_final_eps": 0.1,
    },
    # what Stable-Baselines3's DQN can take over of the profile "tuned"
    "sb3-tuned": {
        "policy_kwargs": {"net_arch": [256, 192, 128]},
        "learning_rate": 5e-4,  # falling linearly to 0, see `_stable_baselines`
        "buffer_size": 50_000,
        "learning_starts": 1000,
        "batch_size": 100,
        "gamma": 0.95,
        "train_freq": 4,
        "target_update_interval": 1,
        "tau": 0.005,
        "exploration_fraction": 0.45,
        "exploration_final_eps": 0.1,
    },
}
# Settings of rl-agents' files on networks of this project, the paper's dueling network and ego attention:
# HighwayEnv/agents/DQNAgent/dueling_ddqn.json and IntersectionEnv/agents/DQNAgent/ego_attention_2h.json. The clip of
# the gradient's norm and the random steps before the first update are this project's.
RL_AGENTS: dict[str, dict[str, Any]] = {
    "rl-agents-dueling": {"network": "dueling", "gamma": 0.8, "batch_size": 32, "target_interval": 50},
    "rl-agents-attention": {"network": "attention", "gamma": 0.95, "batch_size": 64, "target_interval": 512},
}
EXPLORATION = {"rl-agents-dueling": 6000, "rl-agents-attention": 15_000}  # time constant [steps]
LEARNERS = (*STABLE_BASELINES, *RL_AGENTS)


@dataclass(frozen=True)
class Options:
    """Train them where their results are missing, and print the table."""

    out: Path = Path("results/other-learners")
    """Directory for the results."""
    beside: Path | None = None
    """Results of a sweep whose control agents and constant policies stand in the table too."""
    tasks: tuple[str, ...] = tuple(TASKS)
    """Tasks, in their lightest traffic."""
    learners: tuple[str, ...] = LEARNERS
    """Of sb3, sb3-zoo, sb3-tuned, rl-agents-dueling, rl-agents-attention."""
    seeds: int = 3
    """Trainings of each."""
    steps: int | None = None
    """Environment steps; the preset's if left out."""
    episodes: int = 100
    """Test scenarios in each traffic."""
    workers: int = os.cpu_count() or 1
    """Processes."""


@dataclass(frozen=True)
class Training:
    """One training with its test (an `attempt.Task`); its result is a table of test episodes."""

    learner: str
    task: str
    seed: int
    steps: int
    episodes: int
    dynamics: str
    out: Path
    silence: float = 900.0

    @property
    def cost(self) -> float:
        """Rough time."""
        return float(self.steps)

    @property
    def name(self) -> str:
        """What is trained, and a hash of all of it."""
        settings = {**asdict(self), "settings": settings_of(self.learner, self.steps), "out": None}
        digest = sha256_bytes(canonical_json(settings).encode())[:8]
        return f"{self.task}-{self.learner}-s{self.seed}-{digest}"

    @property
    def folder(self) -> Path:
        """For lock and log."""
        return self.out / "work" / self.name

    @property
    def file(self) -> Path:
        """The table of test episodes."""
        return self.out / f"{self.name}.parquet"

    def done(self) -> bool:
        """Whether the table is there."""
        return self.file.exists()

    def compute(self, beat: Beat) -> str:
        """Train, test and write the table."""
        profile = get_preset("standard").profiles()[self.task] if self.learner == "sb3-tuned" else {}
        env = make_env("sumo", self.task, env_config("sumo", self.task, 1))
        try:
            seed = training_seed(self.task, 1, self.seed)
            train = _stable_baselines if self.learner in STABLE_BASELINES else _rl_agents
            policy = train(self, trained_on(env, profile), seed, beat)
            table = evaluate(observed(env, profile), policy, self.task, 1, self.episodes, lambda: beat(1.0))
        finally:
            env.close()
        write_file(self.file, table.to_parquet(index=False))
        return ""


def settings_of(learner: str, steps: int) -> dict[str, Any]:
    """The settings of a learner as plain values.

    Raises:
        UserError: unknown learner.
    """
    if learner in STABLE_BASELINES:
        return STABLE_BASELINES[learner]
    if learner not in RL_AGENTS:
        raise unknown("learner", learner, LEARNERS)
    warm_up = 200
    config = DQNConfig(
        updates=steps - warm_up,
        steps_per_update=1,
        learning_rate_final=5e-4,
        tau=1.0,
        replay_capacity=15_000,
        warm_up=warm_up,
        standardise=False,
        epsilon_final=0.05,
        epsilon_decay=EXPLORATION[learner] / (steps - warm_up),
    )
    return asdict(replace(config, **RL_AGENTS[learner]))


def _stable_baselines(training: Training, env: gym.Env[Any, Any], seed: int, beat: Beat) -> Policy:
    from stable_baselines3 import DQN
    from stable_baselines3.common.callbacks import BaseCallback

    class Alive(BaseCallback):
        def _on_step(self) -> bool:
            beat(self.num_timesteps / training.steps)
            return True

    settings = dict(STABLE_BASELINES[training.learner])
    if training.learner == "sb3-tuned":
        first = float(settings["learning_rate"])
        settings["learning_rate"] = lambda left: first * left
    model = DQN("MlpPolicy", env, seed=seed, device="cpu", **settings)
    model.learn(training.steps, callback=Alive())
    file = training.folder / "model.zip"
    model.save(file)
    return StableBaselines(file, env)


def _rl_agents(training: Training, env: gym.Env[Any, Any], seed: int, beat: Beat) -> Policy:
    from agents.training import train

    config = DQNConfig(**settings_of(training.learner, training.steps))
    return train(env, config, seed, progress=lambda state: beat(state.updates / state.budget)).policy


class Told(Observer):
    """Prints what has ended."""

    def finished(self, task: Training, remark: str) -> None:
        """Say so."""
        print(f"finished: {task.name}", flush=True)


def rows(trainings: list[Training], beside: Path | None) -> pd.DataFrame:
    """Return and crash rate of every training, agent and constant policy: one row each."""
    import pandas as pd

    parts = [
        pd.read_parquet(t.file).assign(task=t.task, learner=t.learner, seed=t.seed)
        for t in trainings
        if t.done()
    ]
    if beside is not None:
        known = load(beside).episodes
        known = known[(known["level"] == 1) & known["task"].isin({t.task for t in trainings})]
        control = known[known["arm"] == "control"].assign(learner=OURS)
        constant = known[known["policy"].isin(CONSTANT_POLICIES)]
        parts += [control, constant.assign(learner=constant["policy"], seed=0)]
    if not parts:
        raise UserError("nothing has been trained yet")
    episodes = pd.concat(parts, ignore_index=True)
    means = episodes.groupby(["task", "learner", "seed", "traffic"])[["return", "crashed"]].mean()
    return means.unstack("traffic").reset_index()


def table(trainings: list[Training], beside: Path | None) -> str:
    """Means over the seeds as Markdown, with the standard error of the return; of the constant policies the best."""
    found = rows(trainings, beside)
    lines = [
        "| task | learner | trainings | return, regular | crash rate, regular | return, risky | crash rate, risky |",
        "|---|---|---|---|---|---|---|",
    ]
    for task in dict.fromkeys(t.task for t in trainings):
        here = found[found["task"] == task]
        constant = here[here["learner"].isin(CONSTANT_POLICIES)]
        best = constant.loc[[constant[("return", "regular")].idxmax()]] if len(constant) else constant
        for learner in (OURS, *LEARNERS, *best["learner"]):
            if len(group := here[here["learner"] == learner]):
                lines.append(_line(task, learner, group))
    return "\n".join(lines)


def _line(task: str, learner: str, group: Mapping[Any, Any]) -> str:
    count = len(group["seed"])
    cells = []
    for traffic in ("regular", "risky"):
        returns = group["return", traffic]
        error = f" ± {returns.std(ddof=1) / count**0.5:.2f}" if count > 1 else ""
        cells += [f"{returns.mean():.2f}{error}", f"{group['crashed', traffic].mean():.2f}"]
    return (
        f"| {task} | {learner} | {count if learner not in CONSTANT_POLICIES else '-'} | {' | '.join(cells)} |"
    )


def main() -> int:
    """Command line."""
    options = tyro.cli(Options, description=__doc__)
    preset = get_preset("standard").profiles()
    trainings = []
    for task in options.tasks:
        level_names(task)  # an unknown task is an error
        config = preset[task]
        steps = options.steps or config["warm_up"] + config["steps_per_update"] * config["updates"]
        trainings += [
            Training(learner, task, seed, steps, options.episodes, dynamics("sumo", task), options.out)
            for seed in range(options.seeds)
            for learner in options.learners
        ]
    left = [training for training in trainings if not training.done()]
    failures: Mapping[str, str] = {}
    if left:
        executor, limit = open_executor("local", options.workers, options.out, 8)
        failures = run(left, executor, limit, Told())
    print(table(trainings, options.beside))
    for name, reason in failures.items():
        print(f"{name}: {reason}", file=sys.stderr)
    return 1 if failures else 0


if __name__ == "__main__":
    run_command(main)
