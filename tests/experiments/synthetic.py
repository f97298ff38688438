"""A finished result directory with made-up episodes, whose truth is known: no simulator and no learner runs.

An agent's chance to crash and its reward are its arm's plus a deviation of its own (its training seed's).
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.study import grid
from experiments.study.arms import ALL_TRAFFICS, ARMS, TRAFFICS, gate_traffics
from experiments.study.evaluate import COLUMNS
from experiments.study.experiment import Experiment
from experiments.study.store import EPISODES, GATES, TRAINING, WEIGHTS, Store
from experiments.study.train import learning_curve

DURATION = {"highway": 20, "two-way": 15, "roundabout": 11, "intersection": 13, "u-turn": 10}
# By policy: chance to crash, reward per step, speed [m/s].
BEHAVIOUR = {
    "idle": (0.7, 0.75, 22.0),
    "random": (0.75, 0.7, 21.0),
    "faster": (0.9, 0.8, 28.0),
    "slower": (0.1, 0.6, 12.0),
    "idm": (0.2, 0.78, 19.0),
    "careful": (0.03, 0.82, 18.0),
    "dqn": (0.25, 0.85, 20.0),
}
TYPES = ("rear-end", "side", "frontal", "junction")
PENALTY = -0.2  # what a doubled penalty for crashes changes about the chance to crash
# What can be wrong with an agent, by name.
FAULTS = ("diverged", "poor")


def generator(*words: object) -> np.random.Generator:
    return np.random.default_rng(zlib.crc32(repr(words).encode()))


def episodes(
    cell: grid.Cell, effect: float, spread: float, fault: str | None, purpose: str = "test"
) -> pd.DataFrame:
    """Episodes of a cell; `effect` is added to the treated agents' chance to crash in risky traffic."""
    random = generator(cell.slug, "test")
    if cell.kind == "test":  # of the same agent
        own = generator(cell.parent.slug, "test").normal(0, spread)
    else:
        own = random.normal(0, spread) if cell.kind == "agent" else 0.0
    if purpose != "test":
        random = generator(cell.slug, purpose)
    chance_to_crash, reward, speed = BEHAVIOUR[cell.policy]
    tables = []
    tested = cell.test_on or {"traffics": TRAFFICS, "episodes": cell.episodes}
    for traffic in tested["traffics"] if purpose == "test" else gate_traffics(cell.arm):
        n = tested["episodes"] if purpose == "test" else cell.gate_episodes
        steps = DURATION[cell.task]
        words = () if purpose == "test" else (purpose,)
        luck = generator(cell.task, cell.level, traffic, *words).uniform(
            size=n
        )  # shared by all who are tested
        dose = ALL_TRAFFICS[traffic]
        chance = chance_to_crash + 0.05 * (cell.level - 1) + own + 0.15 * dose
        chance += effect * cell.risk * dose + PENALTY * (cell.arm == "penalty")
        noise = random.uniform(-0.3, 0.3, n)
        crashed = luck + noise < chance if fault != "diverged" else np.zeros(n, bool)
        length = np.where(crashed, random.integers(2, steps, n), steps)
        per_step = {"poor": 0.1, "diverged": 0.6}.get(fault or "", reward - 0.03 * cell.level - own / 2)
        table: dict[str, Any] = {"traffic": traffic, "scenario": np.arange(n)}
        table["return"] = (
            length * per_step - crashed + (0 if fault == "diverged" else random.normal(0, 0.3, n))
        )
        table["length"], table["crashed"] = length, crashed
        table["arrived"] = (cell.task == "intersection") & ~crashed
        table["truncated"] = ~crashed & ~table["arrived"]
        table["mean_speed"] = speed if fault == "diverged" else np.abs(random.normal(speed, 1.0, n))
        table["distance"] = table["mean_speed"] * length
        table["min_ttc"] = np.where(random.uniform(size=n) < 0.2, np.inf, random.uniform(0.1, 8, n))
        table["near_misses"] = random.poisson(1 + 0.5 * (traffic == "risky"), n)
        table["density"] = random.normal(8 * cell.level, 1, n)
        table["stopped"] = 0.02
        shares = np.eye(5)[4] if fault == "diverged" else np.array([0.1, 0.3, 0.1, 0.2, 0.3])
        actions = np.array([random.multinomial(k, shares) for k in length])
        for action in range(5):
            table[f"action_{action}"] = actions[:, action]
        table["crash_time"] = length - random.uniform(0, 1, n)
        table["crash_other"] = [f"v{k}" for k in random.integers(0, 20, n)]
        ahead = random.uniform(size=n) < 0.7
        table["crash_x"], table["crash_y"] = random.uniform(0, 400, n), 4.0
        table["crash_relative_x"] = np.where(ahead, 4.9, random.uniform(-3, 4, n))
        table["crash_relative_y"] = np.where(ahead, random.normal(0, 0.7, n), 1.9 * random.choice([-1, 1], n))
        table["crash_relative_heading"] = random.normal(0, 0.15, n)
        table["crash_closing_speed"] = np.abs(random.normal(8, 3, n))
        table["crash_type"] = np.where(ahead, "rear-end", random.choice(TYPES[1:], n))
        table["crash_detected_by"] = "both"
        for column in COLUMNS:
            if column.startswith("crash_"):
                known = np.broadcast_to(np.asarray(table[column], dtype=object), n)
                table[column] = np.where(crashed, known, None)
        tables.append(pd.DataFrame(table))
    columns = {
        name: kind for name, kind in COLUMNS.items() if name != "actions"
    }  # as cells of earlier versions
    return pd.concat(tables)[list(columns)].astype(columns)


def training(cell: grid.Cell) -> pd.DataFrame:
    """Training episodes that get longer and safer."""
    random = generator(cell.slug, "training")
    length = random.integers(3, DURATION[cell.task], max(4, cell.updates // 8))
    step = np.cumsum(length)
    progress = step / step[-1]
    crashed = random.uniform(size=len(step)) < 0.9 - 0.6 * progress
    return pd.DataFrame(
        {
            "episode": np.arange(len(step)),
            "step": step,
            "return": length * (0.5 + 0.3 * progress) + random.normal(0, 1, len(step)),
            "length": length,
            "crashed": crashed,
            "arrived": False,
            "mean_speed": 20.0,
            "epsilon": 0.1 + 0.9 * np.exp(-progress * 6),
        }
    )


def learner(cell: grid.Cell, fault: str | None) -> dict[str, Any]:
    bound = (5.0 if cell.task == "intersection" else 1.0) / (1 - cell.profile["gamma"])
    updates = np.linspace(cell.updates / 10, cell.updates, 10)
    top = 1e9 if fault == "diverged" else 0.6 * bound
    largest = [float(top ** (k / 10)) for k in range(1, 11)]
    curve = [[int(u), q / 2, q] for u, q in zip(updates, largest, strict=True)]
    return {
        "updates": cell.updates,
        "episodes": cell.updates // 8,
        "probe_q": curve,
        "curve": learning_curve(training(cell)),
        "q_bound": bound,
    }


def write(
    directory: Path,
    levels: Mapping[str, Sequence[int]],
    seeds: int = 3,
    tests: int = 20,
    preset: str = "quick",
    backend: str = "sumo",
    arms: Sequence[str] = ("control", "treatment"),
    baselines: Sequence[str] = grid.BASELINES,
    effect: float = -0.1,
    spread: float = 0.03,
    faults: Mapping[str, str] | None = None,
    updates: int = 400,
    further: Sequence[str] = (),
    test_on: Sequence[str] = (),
) -> list[grid.Cell]:
    """Write a result directory and return its cells.

    levels: numbers by task. further: arms beside the two.
    faults: a fault by slug, for example {"sumo-highway-50-control-s0": "diverged"}.
    """
    cells = [
        cell
        for task, numbers in levels.items()
        for cell in Experiment(
            backend=backend,
            preset=preset,
            tasks=(task,),
            levels=tuple(numbers),
            seeds=seeds,
            episodes=tests,
            gate_episodes=100,
            learners={task: {"updates": updates, "gamma": 0.95}},
            arms=(*ARMS, *further),
            test_on=tuple(test_on),
        ).cells()
    ]
    # Without a network, no report tries to replay agents that never were.
    known = ("preset", "updates", "gamma")
    cells = [
        replace(cell, profile={name: cell.profile[name] for name in known if name in cell.profile})
        for cell in cells
    ]
    wanted = [cell for cell in cells if cell.arm in (*arms, *further) or cell.policy in baselines]
    store = Store(directory)
    weights = directory / "weights.npz"
    directory.mkdir(parents=True, exist_ok=True)
    weights.write_bytes(b"no weights")
    for cell in wanted:
        fault = (faults or {}).get(cell.slug)
        record: dict[str, Any] = {
            "timing": {"train_seconds": 30.0, "test_seconds": 2.0, "finished": "2026-01-01T00:00:00Z"},
            "provenance": {"packages": {"libsumo": "1.28.0"}, "cpu": "a processor", "git": "0123abc"},
        }
        files: dict[str, Any] = {EPISODES: episodes(cell, effect, spread, fault)}
        if cell.kind != "test":
            files[GATES] = episodes(
                cell, 0.0, spread, fault, "gate"
            )  # sound agents pass, whatever the effect
        if cell.kind == "agent":
            files |= {TRAINING: training(cell), WEIGHTS: weights}
            record["learner"] = learner(cell, fault)
        store.write(cell, record, files)
    weights.unlink()
    store.write_sweep("python experiments/sweep.py", cells)
    return wanted
