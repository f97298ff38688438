"""How each driver does by itself, before anything is compared: what the figure of crashes against speed shows.

And how much more often agents crash than careful and constant drivers of their progress: distance to the frontier.
"""

from typing import Any

import numpy as np
import pandas as pd

from agents.rules import CAUTIONS, POLICIES
from experiments.analysis import estimate
from experiments.analysis.effects import SHARES
from experiments.analysis.estimate import mean_of_units, with_intervals
from experiments.analysis.scores import arms_of, at_home
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING

SHOWN = ("crashed", "mean_speed")
RULES = {*POLICIES, *CAUTIONS} - {"idm", "random"}  # the careful driver and the constant policies
FRONTIER = [*SETTING, "arm", "traffic", "agents", "inside", "estimate", "low", "high"]


def drivers(episodes: pd.DataFrame) -> pd.DataFrame:
    """Crash rate and speed of the agents of each arm, and of policies that do not learn, in regular and risky traffic.

    Args:
        episodes: as from `scores.with_outcomes`.

    Returns:
        A row a SETTING, driver (an arm, or a policy) and traffic: crashed and mean_speed [m/s], and the ends of their
        95 % intervals over agents and scenarios, "crashed_low" and so on; NaN for one agent or a policy.
    """
    rules = episodes[episodes["kind"] == "baseline"]
    agents = episodes[episodes["kind"] == "agent"]
    everybody = pd.concat([agents, rules.assign(arm=rules["policy"], seed=0)])
    ends = [f"{name}{end}" for name in SHOWN for end in ("", "_low", "_high")]
    rows: list[dict[str, Any]] = []
    for setting, arms in arms_of(everybody, SHOWN).items():
        for driver, outcomes in arms.items():
            for place, traffic in enumerate(TRAFFICS):
                row = {**dict(zip(SETTING, setting, strict=True)), "driver": driver, "traffic": traffic}
                for name in SHOWN:
                    row |= _with_ends(name, outcomes[name][place])
                rows.append(row)
    return pd.DataFrame(rows, columns=[*SETTING, "driver", "traffic", *ends])


def _with_ends(name: str, scores: estimate.Scores) -> dict[str, float]:
    """The mean of an outcome and the ends of its interval. scores: of agents and scenarios."""
    floor = estimate.binomial_floor(scores[np.newaxis]) if name in SHARES else 0.0
    found = estimate.interval(estimate.linear([(scores, 1.0)], floor))
    return {name: found.estimate, f"{name}_low": float(found.low), f"{name}_high": float(found.high)}


def hazards(drives: pd.DataFrame) -> pd.DataFrame:
    """Of each agent's drives (rows: cell) still on the road, the share that crashes in each second (columns).

    drives: test episodes as from `scores.with_outcomes`; NaN where an agent has none left.
    """
    second = np.ceil(drives["crash_free_time"]).clip(lower=1).astype(int)
    seconds = range(1, second.max() + 1)
    ending = pd.crosstab(drives["cell"], second).reindex(columns=seconds, fill_value=0)
    crashing = pd.crosstab(drives["cell"], second, drives["crashed"], aggfunc="sum")
    driving = ending.iloc[:, ::-1].cumsum(axis=1).iloc[:, ::-1]
    return crashing.reindex(columns=seconds).fillna(0.0) / driving.where(driving > 0)


def lower_hull(points: pd.DataFrame) -> pd.DataFrame:
    """The corners of the lower convex hull of points (progress, crashed), from the slowest to the fastest."""
    points = points.sort_values(["progress", "crashed"])[["progress", "crashed"]].drop_duplicates("progress")
    rows = points.to_numpy(dtype=float).tolist()
    is_corner = [
        all((x1 - x0) * (y2 - y0) > (y1 - y0) * (x2 - x0) for x0, y0 in rows[:k] for x2, y2 in rows[k + 1 :])
        for k, (x1, y1) in enumerate(rows)  # below the line from any point on its left to any on its right
    ]
    return points.loc[is_corner].reset_index(drop=True)


def to_frontier(episodes: pd.DataFrame) -> pd.DataFrame:
    """The distance of each arm's agents to the frontier of careful and constant drivers, where there are any.

    The frontier is the lower hull of their crash rate over progress, the distance covered over the time limit. An agent
    slower or faster than all of them has no distance.

    Args:
        episodes: as from `scores.with_outcomes`.

    Returns:
        A row a SETTING, arm and traffic: agents, how many of them have a distance (inside), and their mean crash rate
        above the frontier with its 95 % interval over agents. Exploratory.
    """
    rows = at_home(episodes)
    rows = rows.assign(arm=rows["arm"].fillna("").astype(str))
    drivers = rows.groupby([*SETTING, "traffic", "kind", "policy", "arm", "cell"], sort=False)
    drivers = drivers[["progress", "crashed"]].mean().reset_index()
    agents = []
    for _, own in drivers.groupby([*SETTING, "traffic"], sort=False):
        hull = lower_hull(own[own["policy"].isin(RULES)])
        if len(hull) > 1:
            of_hull = np.interp(own["progress"], hull["progress"], hull["crashed"], left=np.nan, right=np.nan)
            agents.append(own.assign(above=own["crashed"] - of_hull)[own["kind"] == "agent"])
    if not agents:
        return pd.DataFrame(columns=FRONTIER)
    rows = pd.concat(agents)
    group = [*SETTING, "arm", "traffic"]
    number = rows.groupby(group, sort=False)["above"].agg(agents="size", inside="count").reset_index()
    return number.merge(with_intervals(mean_of_units(rows.groupby(group, sort=False)["above"])))[FRONTIER]
