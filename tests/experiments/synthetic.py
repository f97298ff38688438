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
from experiments.study.store import EPISODES, GATES, Store

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
PENALTY = -0.2  # what a doubled penalty for crashes changes about the chance to crash


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
        # shared by all who are tested
        luck = generator(cell.task, cell.level, traffic, *words).uniform(size=n)
        dose = ALL_TRAFFICS[traffic]
        chance = chance_to_crash + 0.05 * (cell.level - 1) + own + 0.15 * dose
        chance += effect * cell.risk * dose + PENALTY * (cell.arm == "penalty")
        noise = random.uniform(-0.3, 0.3, n)
        crashed = luck + noise < chance if fault != "diverged" else np.zeros(n, bool)
        length = np.where(crashed, random.integers(2, steps, n), steps)
        per_step = {"poor": 0.1, "diverged": 0.6}.get(fault or "", reward - 0.03 * cell.level - own / 2)
        # Columns that are not set stay missing, as those of a crash where there is none.
        table = pd.DataFrame(
            {"traffic": traffic, "scenario": np.arange(n)}, columns=list(COLUMNS)[:-1]
        )  # as before `actions`
        table["return"] = (
            length * per_step - crashed + (0 if fault == "diverged" else random.normal(0, 0.3, n))
        )
        table["length"], table["crashed"] = length, crashed
        table["arrived"] = (cell.task == "intersection") & ~crashed
        table["truncated"] = ~crashed & ~table["arrived"]
        table["mean_speed"] = speed if fault == "diverged" else np.abs(random.normal(speed, 1.0, n))
        table["distance"] = table["mean_speed"] * length
        table["near_misses"] = random.poisson(1 + 0.5 * (traffic == "risky"), n)
        table["density"], table["stopped"] = 8.0 * cell.level, 0.02
        shares = np.eye(5)[4] if fault == "diverged" else np.array([0.1, 0.3, 0.1, 0.2, 0.3])
        table[[f"action_{k}" for k in range(5)]] = [random.multinomial(k, shares) for k in length]
        table["crash_time"] = np.where(crashed, length - random.uniform(0, 1, n), np.nan)
        table["crash_closing_speed"] = np.where(crashed, np.abs(random.normal(8, 3, n)), np.nan)
        tables.append(table)
    return pd.concat(tables).astype({name: COLUMNS[name] for name in table})


def learner(cell: grid.Cell, fault: str | None) -> dict[str, Any]:
    """What is kept of a training, whose episodes get longer and safer."""
    bound = (5.0 if cell.task == "intersection" else 1.0) / (1 - cell.profile["gamma"])
    largest = 1e9 if fault == "diverged" else 0.6 * bound
    progress = np.linspace(0.05, 1, 20)
    reward = 8 * (0.5 + 0.3 * progress) + generator(cell.slug, "training").normal(0, 1, 20)
    return {
        "updates": cell.updates,
        "episodes": cell.updates // 8,
        "probe_q": [[cell.updates, largest / 2, largest]],
        "curve": {
            "step": (4 * cell.updates * progress).tolist(),
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
    baselines: Sequence[str] = grid.BASELINES,
    effect: float = -0.1,
    spread: float = 0.03,
    faults: Mapping[str, str] | None = None,
    updates: int = 400,
    further: Sequence[str] = (),
    **asked: Any,
) -> list[grid.Cell]:
    """Write a result directory and return its cells.

    levels: numbers by task. further: arms beside the two. asked: of the experiment.
    faults: "diverged" or "poor" by slug, for example {"sumo-highway-50-control-s0": "diverged"}.
    """
    # Without a network, no report tries to replay agents that never were.
    known = ("preset", "updates", "gamma")
    cells = [
        replace(cell, profile={name: value for name, value in cell.profile.items() if name in known})
        for task, numbers in levels.items()
        for cell in Experiment(
            tasks=(task,),
            levels=tuple(numbers),
            episodes=tests,
            gate_episodes=100,
            learners={task: {"updates": updates, "gamma": 0.95}},
            arms=(*ARMS, *further),
            **{"preset": "quick", "seeds": 3, **asked},
        ).cells()
    ]
    wanted = [cell for cell in cells if cell.arm in (*arms, *further) or cell.policy in baselines]
    store = Store(directory)
    for cell in wanted:
        fault = (faults or {}).get(cell.slug)
        record: dict[str, Any] = {
            "timing": {"train_seconds": 30.0, "test_seconds": 2.0, "finished": "2026-01-01T00:00:00Z"},
            "provenance": {"packages": {"libsumo": "1.28.0"}, "cpu": "a processor", "git": "0123abc"},
        }
        files: dict[str, Any] = {EPISODES: episodes(cell, effect, spread, fault)}
        if cell.kind != "test":
            # sound agents pass, whatever the effect
            files[GATES] = episodes(cell, 0.0, spread, fault, "gate")
        if cell.kind == "agent":
            record["learner"] = learner(cell, fault)
        store.write(cell, record, files)
    store.write_sweep("python experiments/sweep.py", cells)
    return wanted
