"""What training did, task by task: the columns that every report and page leads with, in every traffic of the tests.

A task is one number only where its levels are averaged, each alike. A mean over tasks has beside it the same mean
without each task in turn, because one task can make it.
"""

from __future__ import annotations

import pandas as pd

from experiments.analysis.effects import COMPARISON, ESTIMATE, MEANS, contrasts, means
from experiments.analysis.gates import CROSSINGS
from experiments.analysis.plan import DEFAULT, OUTCOMES, Outcome, Plan
from experiments.analysis.scores import arms_of
from experiments.study.design.arms import ARMS
from experiments.study.results.loaded import AGENT

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
    "hard_crash": Outcome(f"at {HARD:.0f} m/s or more", "[%]", -1, 1, percent=True, poolable=True, of=_hard),
    "entered": Outcome("enters", "[%]", 0, 0, percent=True, of=_entered),
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
    tests = rows[rows["kind"] == "test"].merge(agents[AGENT].drop_duplicates())
    found = []
    for simulator, here in pd.concat([agents, tests]).groupby("tested_on", sort=False):
        effects = pd.concat([_effects(own, str(name)) for name, own in here.groupby("traffic", sort=False)])
        poolable = effects[effects["outcome"].isin([name for name, one in COLUMNS.items() if one.poolable])]
        both = [means(effects, plan, outcomes=COLUMNS), means(poolable, plan, True, COLUMNS)]
        found += [frame.assign(tested_on=simulator) for frame in both]
    if not found:
        return pd.DataFrame(columns=ROW)
    return pd.concat(found, ignore_index=True).rename(columns={"term": "traffic"})[ROW]


def _effects(rows: pd.DataFrame, traffic: str) -> pd.DataFrame:
    """Treatment minus control in all COLUMNS, in every setting and in this traffic, which all rows are of."""
    asked = {("treatment", "control"): [(outcome, traffic) for outcome in COLUMNS]}
    return contrasts(arms_of(rows, COLUMNS, (traffic,)), asked, terms={traffic: (1.0,)})
