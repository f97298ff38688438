"""What training did, task by task: the columns that every report and page leads with, in every traffic of the tests.

A task is one number only where its levels are averaged, each alike. A mean over tasks has beside it the same mean
without each task in turn, because one task can make it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.effects import COMPARISON, ESTIMATE, MEANS, means
from experiments.analysis.gates import CROSSINGS
from experiments.analysis.plan import DEFAULT, OUTCOMES, Outcome, Plan
from experiments.analysis.scores import SETTING, in_order, once_each
from experiments.study.design.arms import ARMS

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
ROW = [*COMPARISON, "tested_on", "scope", "outcome", "traffic", *ESTIMATE, *MEANS, "settings"]


def by_task(episodes: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """Differences between treatment and control in all COLUMNS, task by task.

    Args:
        episodes: as from `scores.with_outcomes`, with the columns of OWN. plan: whose settings are averaged.

    Returns:
        A row a COMPARISON, scope (a task, "all tasks", "without TASK"; the last two for outcomes that mean the same on
        every task), outcome and traffic, also one that nobody was trained in: ESTIMATE, MEANS and settings (their
        number). Agents that are not there at home count nowhere.
    """
    rows = episodes[episodes["arm"].isin(ARMS)]
    agents = rows[rows["kind"] == "agent"]
    tests = rows[rows["kind"] == "test"].merge(agents[[*SETTING, "arm", "seed"]].drop_duplicates())
    effects = pd.DataFrame(_effects(pd.concat([agents, tests])))
    if effects.empty:
        return pd.DataFrame(columns=ROW)
    found = []
    for simulator, here in effects.groupby("tested_on", sort=False):
        poolable = here[here["outcome"].isin([name for name, one in COLUMNS.items() if one.poolable])]
        both = [means(here, plan, outcomes=COLUMNS), means(poolable, plan, True, COLUMNS)]
        found += [frame.assign(tested_on=simulator) for frame in both]
    return pd.concat(found, ignore_index=True).rename(columns={"term": "traffic"})[ROW]


def _effects(rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Of every setting, simulator and traffic of the tests the rows that `effects.means` averages."""
    place = [*SETTING, "tested_on", "traffic"]
    rows = in_order(rows, "backend", "task", "level", "seed", "scenario")
    for names, group in rows.groupby(place, sort=False):
        arms = {str(arm): own for arm, own in once_each(group).groupby("arm", sort=False)}
        if len(arms) < len(ARMS):
            continue
        label = {**dict(zip(place, names, strict=True)), "arm": "treatment", "against": "control"}
        label["term"] = label.pop("traffic")
        for outcome, kind in COLUMNS.items():
            if group[outcome].notna().all():
                both = [arms[name] for name in ("treatment", "control")]
                yield {**label, "outcome": outcome, **_contrast(both, outcome, kind.percent)}


def _contrast(both: Sequence[pd.DataFrame], outcome: str, floored: bool) -> dict[str, Any]:
    """One arm minus the other on the same scenarios: a `Mean`, and MEANS.

    Args:
        both: their episodes, sorted by seed and scenario. floored: of a share of episodes, which has a least variance.
    """
    tables = [own[outcome].to_numpy(dtype=float).reshape(own["seed"].nunique(), -1) for own in both]
    floor = sum(estimate.binomial_floor([table]) for table in tables) if floored else 0.0
    found = estimate.linear([(tables[0], 1.0), (tables[1], -1.0)], floor)
    values = [*(float(table.mean()) for table in tables), *map(len, tables)]
    return {**found._asdict(), **dict(zip(MEANS, values, strict=True))}
