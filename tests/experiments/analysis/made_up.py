"""Scores that are made up, their effects, and one row of a table by its values."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis.effects import adjusted, contrasts
from experiments.analysis.plan import DEFAULT, OUTCOMES, TERMS, Plan
from experiments.analysis.scores import Arms, Setting
from experiments.study.design.sheet import GRID

PAIR = ("treatment", "control")


def find(frame: pd.DataFrame, **wanted: Any) -> dict[str, Any]:
    """The one row with these values, of treatment against control where that is a question."""
    if "against" in frame:
        wanted = {"arm": "treatment", "against": "control", **wanted}
    for name, value in wanted.items():
        frame = frame[frame[name] == value]
    [row] = frame.to_dict("records")
    return {str(key): value for key, value in row.items()}


def agents(
    levels: int,
    seeds: int,
    random: np.random.Generator,
    effect: float = 0.0,
    spread: float = 1.0,
    task: str = "highway",
    growth: float = 0.0,
) -> dict[Setting, Arms]:
    """Settings of one task, each agent with nearly the same score in all scenarios, in every outcome."""
    result: dict[Setting, Arms] = {}
    for level in range(1, levels + 1):
        pair = {}
        for arm in ("control", "treatment"):
            own = random.normal(0, spread, (1, seeds, 1)) + random.normal(0, 0.3 * spread, (2, seeds, 1))
            added = (effect + growth * level) * (arm == "treatment")
            scores = 10 + own + added + random.normal(0, 0.01 * spread, (2, seeds, 5))
            pair[arm] = {name: scores.copy() for name in OUTCOMES}
        result["sumo", task, level, GRID[task][level - 1]] = pair
    return result


def crashes(
    rates: Mapping[str, tuple[float, float]], random: np.random.Generator, spread: float, scenarios: int = 100
) -> Arms:
    """Five agents an arm with these rates in regular and risky traffic; half of their luck is the scenario's."""
    luck, arms = random.uniform(size=(2, 1, scenarios)), {}
    for arm, rate in rates.items():
        chance = np.array(rate)[:, None, None] + random.normal(0, spread, (2, 5, 1))
        own = random.uniform(size=(2, 5, scenarios))
        crashed = np.where(random.uniform(size=own.shape) < 0.5, luck, own) < chance
        arms[arm] = {"crashed": crashed.astype(float)}
    return arms


def effects(arms: Mapping[Setting, Arms], plan: Plan = DEFAULT) -> pd.DataFrame:
    return adjusted(contrasts(arms, {PAIR: [(o, t) for o in OUTCOMES for t in TERMS]}), plan)
