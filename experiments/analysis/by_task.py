"""What training did, task by task: the columns that every report and page leads with, in every traffic of the tests.

A task is one number only where its levels are averaged, each alike. A mean over tasks has beside it the same mean
without each task in turn, because one task can make it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any

import pandas as pd

from experiments.analysis import estimate, pairs
from experiments.analysis.effects import COMPARISON, ESTIMATE, MEANS, means
from experiments.analysis.gates import CROSSINGS
from experiments.analysis.plan import DEFAULT, OUTCOMES, Outcome, Plan
from experiments.analysis.scores import SETTING, in_order, once_each
from experiments.study.design.arms import PAIRS, REGISTERED

HARD = 10.0  # closing speed from which a crash is hard [m/s]


def _hard(episodes: pd.DataFrame) -> pd.Series:
    """Whether an episode ends in a hard crash."""
    return (episodes["crashed"] & (episodes["crash_closing_speed"] >= HARD)).astype(float)


def _entered(episodes: pd.DataFrame) -> pd.Series:
    """Whether the ego gets into the roundabout or intersection; NaN in tasks without one."""
    way = episodes["task"].map(CROSSINGS).astype(float)
    return (episodes["distance"] >= way).astype(float).where(way.notna())


# Of the columns those that the plans do not know; they are exploratory.
OWN = {
    "hard_crash": Outcome(
        f"Crashes at {HARD:.0f} m/s or more", "of episodes", -1, 1, percent=True, poolable=True, of=_hard
    ),
    "entered": Outcome("Enters the crossing", "of episodes", 0, 0, percent=True, of=_entered),
}
COLUMNS: dict[str, Outcome] = {
    **{name: OUTCOMES[name] for name in ("crashed", "crashes_per_100_km")},
    "hard_crash": OWN["hard_crash"],
    **{name: OUTCOMES[name] for name in ("mean_speed", "return")},
    "entered": OWN["entered"],
}
ASKED = [("treatment", "control"), ("mixed", "control")]
ASKED_OF_PAIRS = [(REGISTERED, arm) for arm in ("treatment", "control")]
ROW = [*COMPARISON, "scope", "outcome", "traffic", *ESTIMATE, *MEANS, "settings"]


def by_task(episodes: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """Differences between arms in all COLUMNS, task by task.

    Args:
        episodes: as from `scores.with_outcomes`, with the columns of OWN. plan: whose settings are averaged.

    Returns:
        A row a COMPARISON, scope (a task, "all tasks", "without TASK"; the last two for outcomes that mean the same on
        every task), outcome and traffic, also one that nobody was trained in: ESTIMATE, MEANS and settings (their
        number). Agents that are not there at home count nowhere.
    """
    agents = episodes[episodes["kind"] == "agent"]
    known = agents[[*SETTING, "arm", "seed"]].drop_duplicates()
    tests = episodes[(episodes["kind"] == "test") & ~episodes["arm"].isin(list(PAIRS))].merge(known)
    rows = [*_effects(pd.concat([agents, tests]), ASKED), *_effects(pairs.units(episodes), ASKED_OF_PAIRS)]
    if not rows:
        return pd.DataFrame(columns=ROW)
    effects = pd.DataFrame(rows).assign(scenarios="own")
    poolable = effects[effects["outcome"].isin([name for name, one in COLUMNS.items() if one.poolable])]
    found = [
        means(effects, plan, outcomes=COLUMNS),
        means(poolable, plan, leave_one_out=True, outcomes=COLUMNS),
    ]
    return pd.concat(found, ignore_index=True).rename(columns={"term": "traffic"})[ROW]


def _effects(rows: pd.DataFrame, asked: list[tuple[str, str]]) -> Iterator[dict[str, Any]]:
    """Of every setting, simulator and traffic of the tests the rows that `effects.means` averages."""
    place = [*SETTING, "tested_on", "traffic"]
    rows = rows[rows["arm"].isin({*chain(*asked)})]
    for names, group in in_order(rows, "backend", "task", "level", "seed", "scenario").groupby(
        place, sort=False
    ):
        arms = {str(arm): own for arm, own in once_each(group).groupby("arm", sort=False)}
        for arm, against in asked:
            if {arm, against} <= arms.keys():
                label = {**dict(zip(place, names, strict=True)), "arm": arm, "against": against}
                label["term"] = label.pop("traffic")
                for outcome, kind in COLUMNS.items():
                    if group[outcome].notna().all():
                        found = _contrast(arms[arm], arms[against], outcome, kind.percent, arm in PAIRS)
                        yield {**label, "outcome": outcome, **found}


def _contrast(
    arm: pd.DataFrame, against: pd.DataFrame, outcome: str, floored: bool, paired: bool
) -> dict[str, Any]:
    """One arm minus the other on the same scenarios: a `Mean`, and MEANS.

    Args:
        arm, against: episodes sorted by seed and scenario. floored: of a share of episodes, which has a least variance.
        paired: the difference is taken within each seed.
    """
    tables = [own[outcome].to_numpy(dtype=float).reshape(own["seed"].nunique(), -1) for own in (arm, against)]
    floor = sum(estimate.binomial_floor([table]) for table in tables) if floored else 0.0
    weighted = [(tables[0] - tables[1], 1.0)] if paired else [(tables[0], 1.0), (tables[1], -1.0)]
    found = estimate.linear(weighted, floor)
    values = [*(float(table.mean()) for table in tables), *map(len, tables)]
    return {**found._asdict(), **dict(zip(MEANS, values, strict=True))}
