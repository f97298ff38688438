"""What training did, task by task: the columns that every report and page leads with, in every traffic of the tests.

A task is one number only where its levels are averaged, each alike. A mean over tasks has beside it the same mean
without each task in turn, because one task can make it.
"""

from collections.abc import Iterable, Mapping

import pandas as pd

from experiments.analysis.effects import COMPARISON, ESTIMATE, MEANS, contrasts, means
from experiments.analysis.plan import DEFAULT, OUTCOMES, Outcome, Plan
from experiments.analysis.scores import arms_of, per_metre
from experiments.study.design.arms import ARMS
from experiments.study.design.sheet import sheet
from experiments.study.results.loaded import AGENT

HARD = 10.0  # closing speed from which a crash is hard [m/s]
CLOSE = 1.0  # time to collision below which an episode was dangerous [s]


def _hard(episodes: pd.DataFrame) -> pd.Series:
    """Whether an episode ends in a hard crash."""
    return (episodes["crashed"] & (episodes["crash_closing_speed"] >= HARD)).astype(float)


def _entered(episodes: pd.DataFrame) -> pd.Series:
    """Whether the ego gets into the roundabout or intersection; NaN in tasks without one."""
    ways = {task: sheet(task).crossing for task in episodes["task"].unique()}
    way = episodes["task"].map(ways).astype(float)
    return (episodes["distance"] >= way).astype(float).where(way.notna())


def _near_misses(episodes: pd.DataFrame) -> pd.Series:
    """Near misses per kilometre, see `scores.per_metre`."""
    return per_metre(episodes, "near_misses", ["cell", "traffic"]) * 1e3


def _close(episodes: pd.DataFrame) -> pd.Series:
    """Whether the time to collision is ever below CLOSE."""
    return (episodes["min_ttc"] < CLOSE).astype(float)


# Of the columns those that the plans do not know; they are exploratory.
OWN = {
    "hard_crash": Outcome(f"at {HARD:.0f} m/s or more", "[%]", -1, 1, percent=True, poolable=True, of=_hard),
    "entered": Outcome("enters", "[%]", 0, 0, percent=True, of=_entered),
}
SHOWN = ("crashed", "crashes_per_100_km", "hard_crash", "mean_speed", "return", "score", "entered")
COLUMNS: dict[str, Outcome] = {name: (OUTCOMES | OWN)[name] for name in SHOWN}
# Danger without a crash: exploratory, and in no column of the report.
SURROGATES: dict[str, Outcome] = {
    "near_misses_per_km": Outcome("near misses per km", "", -1, 1, of=_near_misses),
    "close": Outcome(f"below {CLOSE:.0f} s", "[%]", -1, 0, percent=True, poolable=True, of=_close),
}
ROW = [*COMPARISON, "tested_on", "scope", "outcome", "traffic", *ESTIMATE, *MEANS, "settings"]


def by_task(
    episodes: pd.DataFrame, plan: Plan = DEFAULT, outcomes: Mapping[str, Outcome] = COLUMNS
) -> pd.DataFrame:
    """Differences between treatment and control in all outcomes, task by task.

    Args:
        episodes: as from `scores.with_outcomes`, with these outcomes. plan: whose settings are averaged.

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
        traffics = here.groupby("traffic", sort=False)
        effects = pd.concat([_effects(own, str(name), outcomes) for name, own in traffics])
        both = [means(effects, plan, leave_one_out, outcomes) for leave_one_out in (False, True)]
        found += [frame.assign(tested_on=simulator) for frame in both]
    if not found:
        return pd.DataFrame(columns=ROW)
    return pd.concat(found, ignore_index=True).rename(columns={"term": "traffic"})[ROW]


def _effects(rows: pd.DataFrame, traffic: str, outcomes: Iterable[str]) -> pd.DataFrame:
    """Treatment minus control in all outcomes, in every setting and in this traffic, which all rows are of."""
    asked = {("treatment", "control"): [(outcome, traffic) for outcome in outcomes]}
    return contrasts(arms_of(rows, outcomes, (traffic,)), asked, terms={traffic: (1.0,)})
