"""A finished result directory with made-up episodes, whose truth is known: no simulator and no learner runs.

An agent's chance to crash and its reward are its arm's plus a deviation of its own (its training seed's).
"""

import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import pandas as pd

from agents.rules import POLICIES
from experiments.study.design.arms import ARMS, EVERY_ARM, gate_traffics
from experiments.study.design.cell import Cell
from experiments.study.design.experiment import Experiment
from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import AT_A_DOSE
from experiments.study.results.schema import COLUMNS, EPISODES, GATES
from experiments.study.results.store import Store

DURATION = {"highway": 20, "two-way": 15, "roundabout": 11, "intersection": 13, "u-turn": 10}
# By policy: chance to crash, reward per step, speed [m/s].
BEHAVIOUR = {
    "idle": (0.7, 0.75, 22.0),
    "random": (0.75, 0.7, 21.0),
    "faster": (0.9, 0.8, 28.0),
    "slower": (0.1, 0.6, 12.0),
    "idm": (0.2, 0.78, 19.0),
    "careful": (0.03, 0.82, 18.0),
    "planner": (0.01, 0.85, 19.0),
    "sumo": (0.3, 0.8, 21.0),
    "dqn": (0.25, 0.85, 20.0),
}


def generator(*words: object) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(repr(words).encode()))


def episodes(cell: Cell, effect: float, spread: float, purpose: str = "test") -> pd.DataFrame:
    """Episodes of a cell; `effect` is added to the treated agents' chance to crash in risky traffic."""
    agent = cell.parent if cell.kind == "test" else cell
    own = generator(agent.slug, "agent").normal(0, spread) if cell.arm else 0.0
    random = generator(cell.slug, purpose)
    chance_to_crash, reward, speed = BEHAVIOUR[cell.policy]
    tested = cell.tested
    if purpose == "gate":
        tested = {"traffics": gate_traffics(cell.arm), "episodes": cell.eval["gate_episodes"]}
    tables, n, steps = [], tested["episodes"], DURATION[task_of(cell.task)]
    for traffic in tested["traffics"]:
        luck = generator(cell.task, cell.level, traffic, purpose).uniform(size=n)  # of all who are tested
        dose = AT_A_DOSE[traffic]
        chance = chance_to_crash + 0.05 * (cell.level - 1) + own + 0.15 * dose
        risk = EVERY_ARM[cell.arm].traffic.dose if cell.arm else 0.0
        chance += effect * risk * dose
        crashed = luck + random.uniform(-0.3, 0.3, n) < chance
        length = np.where(crashed, random.integers(2, steps, n), steps)
        table: dict[str, Any] = {"traffic": np.full(n, traffic, object), "scenario": np.arange(n)}
        table["return"] = length * (reward - 0.03 * cell.level - own / 2) - crashed + random.normal(0, 0.3, n)
        table |= {"length": length, "crashed": crashed, "arrived": (cell.task == "intersection") & ~crashed}
        table["truncated"] = ~crashed & ~table["arrived"]
        table["mean_speed"] = np.abs(random.normal(speed, 1.0, n))
        table["distance"] = table["mean_speed"] * length
        table["near_misses"] = np.minimum(random.poisson(1 + 0.5 * (traffic == "risky"), n), length)
        table |= {
            "min_ttc": np.full(n, np.inf),
            "density": np.full(n, 8.0 * cell.level),
            "stopped": np.full(n, 0.02),
        }
        actions = random.multinomial(length, [0.1, 0.3, 0.1, 0.2, 0.3])
        table |= {f"action_{k}": actions[:, k] for k in range(5)}
        table["actions"] = ["".join(map(str, np.repeat(range(5), counts))) for counts in actions]
        table["crash_time"] = np.where(crashed, length - random.uniform(0, 1, n), np.nan)
        table["crash_closing_speed"] = np.where(crashed, np.abs(random.normal(8, 3, n)), np.nan)
        for name in ("x", "y", "relative_x", "relative_y", "relative_heading"):
            table[f"crash_{name}"] = np.where(crashed, 0.0, np.nan)
        for name, word in {"other": "a car", "type": "rear-end", "detected_by": "sumo"}.items():
            table[f"crash_{name}"] = np.where(crashed, np.array(word, object), None)
        tables.append(table)
    columns = {
        name: pd.array(np.concatenate([table[name] for table in tables]), dtype=kind)
        for name, kind in COLUMNS.items()
    }
    return pd.DataFrame(columns, np.concatenate([np.arange(n)] * len(tables)))


def learner(cell: Cell, diverged: bool) -> dict[str, Any]:
    """What is kept of a training, whose episodes get longer and safer."""
    bound = (5.0 if cell.task == "intersection" else 1.0) / (1 - cell.profile["gamma"])
    largest = 1e9 if diverged else 0.6 * bound
    progress = np.linspace(0.05, 1, 20)
    reward = 8 * (0.5 + 0.3 * progress) + generator(cell.slug, "training").normal(0, 1, 20)
    return {
        "updates": cell.budget[1],
        "episodes": cell.budget[1] // 8,
        "probe_q": [[cell.budget[1], largest / 2, largest]],
        "curve": {
            "step": (4 * cell.budget[1] * progress).tolist(),
            "return": reward.tolist(),
            "crashed": (0.9 - 0.6 * progress).tolist(),
        },
        "q_bound": bound,
    }


def write(
    directory: Path,
    levels: Mapping[str, Sequence[int]],
    tests: int = 20,
    arms: Sequence[str] = ("control", "treatment"),
    baselines: Sequence[str] = POLICIES,
    effect: float = -0.1,
    spread: float = 0.03,
    diverged: str = "",
    updates: int = 400,
    further: Sequence[str] = (),
    **asked: Any,
) -> list[Cell]:
    """Write a result directory and return its cells.

    levels: numbers by task. diverged: slug of an agent. further: arms beside the two. asked: of the experiment.
    """
    cells = [
        cell
        for task, numbers in levels.items()
        for cell in Experiment(
            tasks=(task,),
            levels=tuple(numbers),
            episodes=tests,
            gate_episodes=100,
            learners=lambda _: {"updates": updates, "gamma": 0.95},
            arms=(*ARMS, *further),
            **{"preset": "quick", "about": "", "seeds": 3, **asked},
        ).cells()
    ]
    arms = (*arms, *further)
    wanted = [cell for cell in cells if cell.arm in arms or cell.policy in baselines]
    wanted = [cell for cell in wanted if set(cell.tested["traffics"]) <= set(AT_A_DOSE)]
    store = Store(directory)
    for cell in wanted:
        record: dict[str, Any] = {
            "timing": {"train_seconds": 30.0, "test_seconds": 2.0, "finished": "2026-01-01T00:00:00Z"},
            "provenance": {"packages": {"libsumo": "1.28.0"}, "cpu": "a processor", "git": "0123abc"},
        }
        files: dict[str, Any] = {EPISODES: episodes(cell, effect, spread)}
        if cell.test_on is None:
            # sound agents pass, whatever the effect
            files[GATES] = episodes(cell, 0.0, spread, "gate")
        if cell.kind == "agent":
            record["learner"] = learner(cell, cell.slug == diverged)
        with mock.patch("os.fsync"):  # half of the time, for files that no power cut meets
            store.write(cell, record, files)
    store.write_sweep("python experiments/sweep.py", cells)
    return wanted
