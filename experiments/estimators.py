"""Train the estimators of the dose of risk (`agents.belief`), and say how good they are.

    python experiments/estimators.py u-turn-3 u-turn-12 highway-50 highway-150    # some minutes each

writes results/estimators/SETTING.npz and a row of results/estimators/estimators.csv for each setting. Labelled episodes
are driven by published agents, half of the episodes with some random actions, in scenarios that no test and no training
meets.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from contextlib import closing
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
import pandas as pd
import torch
import tyro
from scipy.stats import mannwhitneyu

import agents
from agents.belief import Estimator, features, fit
from agents.greedy import Greedy
from agents.plugins import sha256
from agents.rules.perception import Perception
from agents.streams import stream
from experiments.backends import make_env
from experiments.study.design import estimators
from experiments.study.design.arms import scenario_seed
from experiments.study.design.levels import env_config, level_names
from experiments.study.design.traffic import TRAFFICS
from experiments.support.arguments import command
from experiments.support.errors import check_known
from sumo_env.tasks import TASKS

DRIVERS = "control", "treatment"
RANDOM = 0.15  # share of random actions in every second scenario
# Scenarios that it is trained on, each at both doses. On the u-turn a belief is worth most; on the highway an episode
# takes long.
SCENARIOS = {"u-turn": 1200, "highway": 300}
OTHERS = 700
HELD_OUT = 150  # scenarios that it is judged on, each at both doses
SECONDS = 1, 2, 3, 5, 8
SEED = 0


@dataclass(frozen=True)
class Options:
    """Train the estimators of the dose of risk."""

    settings: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="SETTING ...")]
    """For example u-turn-3 or two-way-5+2."""


def published(task: str, level: int) -> list[Greedy]:
    """The agents that drive: published ones of the setting, or of the lightest one where it has none."""
    names = level_names(task)
    there = agents.cards()
    setting = next(
        name
        for name in (f"{task}-{names[level - 1]}", f"{task}-{names[0]}")
        if f"{name}/{DRIVERS[-1]}" in there
    )
    return [agents.load(setting, arm) for arm in DRIVERS]


def collect(task: str, level: int, scenarios: range) -> list[np.ndarray]:
    """What an estimator reads in these scenarios at dose 0 and 1, see `agents.belief.fit`."""
    drivers, rows = published(task, level), []
    with closing(make_env("sumo", task, env_config("sumo", task, level))) as env:
        inner: Any = env.unwrapped
        steps, perception = (
            round(inner.config["duration"] * inner.config["policy_frequency"]),
            Perception(env),
        )
        actions = int(inner.action_space.n)
        for scenario in scenarios:
            for dose in range(len(TRAFFICS)):
                seed = scenario_seed(task, level, scenario, "estimator")
                rng, driver = stream(seed, f"driver {dose}"), drivers[scenario % len(drivers)]
                table, _ = env.reset(seed=seed, options={"config": {"risk": float(dose)}})
                driver.reset(seed)
                perception.reset()
                read: list[Any] = []
                while len(read) < steps:
                    read.append(features(perception.look(table), len(table)))
                    wanted = driver.act(table)  # it counts the time, so it is asked at every step
                    noisy = scenario // len(drivers) % 2 and rng.random() < RANDOM
                    table, _, terminated, truncated, _ = env.step(
                        int(rng.integers(actions)) if noisy else wanted
                    )
                    if terminated or truncated:
                        break
                lacking = steps - len(read)
                ego, vehicles = (
                    np.pad(np.stack(part), [(0, lacking)] + [(0, 0)] * part[0].ndim)
                    for part in zip(*read, strict=True)
                )
                rows.append((ego, vehicles, np.arange(steps) < len(read), float(dose)))
    return [np.stack(part).astype(np.float32) for part in zip(*rows, strict=True)]


def judged(logits: np.ndarray, alive: np.ndarray, dose: np.ndarray) -> dict[str, float]:
    """AUC after so many tables more than the first, and the share called risky after 3, among episodes not yet over."""
    found = {}
    for second in SECONDS:
        there = alive[:, second] > 0
        risky, regular = (logits[there & (dose == label), second] for label in (1, 0))
        pairs = len(risky) * len(regular)  # none where nobody drives so long
        found[f"auc_{second}s"] = float(mannwhitneyu(risky, regular).statistic / pairs) if pairs else np.nan
        if second == 3:
            found |= {
                "called_risky_in_risky": (risky > 0).mean(),
                "called_risky_in_regular": (regular > 0).mean(),
            }
    return found


def train(task: str, level: int) -> dict[str, Any]:
    """Train, judge and store the estimator of a setting; returns its row."""
    name = f"{task}-{level_names(task)[level - 1]}"
    number = SCENARIOS.get(task, OTHERS)
    torch.set_num_threads(1)
    ego, vehicles, alive, dose = map(torch.from_numpy, collect(task, level, range(number)))
    file = estimators.FOLDER / f"{name}.npz"
    fit(ego, vehicles, alive, dose, seed=SEED).save(file)
    estimator = Estimator.load(file)  # in half precision
    read, others, there, risk = collect(task, level, range(number, number + HELD_OUT))
    with torch.inference_mode():
        logits = estimator(torch.from_numpy(read), torch.from_numpy(others))[0].numpy()
    # stays once it is over
    last = np.maximum.accumulate(np.where(there > 0, np.arange(there.shape[1]), 0), axis=1)
    estimator.traces = torch.from_numpy(logits).take_along_dim(torch.from_numpy(last), 1).sigmoid()
    estimator.save(file)
    row = {"setting": name, "episodes": 2 * number, "held_out": 2 * HELD_OUT, **judged(logits, there, risk)}
    return {
        **row,
        "weights": sum(p.numel() for p in estimator.parameters()),
        "sha256": sha256(file),
    }


def main(options: Options) -> int:
    """Train the estimators of these settings. Raises UserError for a setting that there is not."""
    known = {f"{task}-{name}": (task, k + 1) for task in TASKS for k, name in enumerate(level_names(task))}
    estimators.FOLDER.mkdir(parents=True, exist_ok=True)
    check_known("setting", options.settings, known)
    for name in options.settings:
        row = pd.DataFrame([train(*known[name])]).round(3)
        file = estimators.FOLDER / "estimators.csv"
        table = pd.concat([pd.read_csv(file), row]) if file.exists() else row
        table.drop_duplicates("setting", keep="last").sort_values("setting").to_csv(file, index=False)
        print(row.T.to_string(header=False))
    return 0


if __name__ == "__main__":
    command(main, Options, __doc__)
