"""How much more often agents crash than careful and constant drivers of their progress: distance to the frontier."""

from __future__ import annotations

import numpy as np
import pandas as pd

from agents.rules import CAUTIONS
from experiments.analysis.estimate import Mean, interval
from experiments.analysis.scores import PLACE
from experiments.study.grid import BASELINES

RULES = {*BASELINES, *CAUTIONS} - {"idm", "random"}  # the careful driver and the constant policies
COLUMNS = [*PLACE, "arm", "traffic", "agents", "inside", "estimate", "low", "high"]


def lower_hull(points: pd.DataFrame) -> pd.DataFrame:
    """The corners of the lower convex hull of points (progress, crashed), from the slowest to the fastest."""
    corners: list[tuple[float, float]] = []
    for point in points.sort_values(["progress", "crashed"])[["progress", "crashed"]].itertuples(index=False):
        while len(corners) > 1 and _turn(corners[-2], corners[-1], point) <= 0:
            corners.pop()
        if not corners or point[0] > corners[-1][0]:
            corners.append((point[0], point[1]))
    return pd.DataFrame(corners, columns=["progress", "crashed"])


def _turn(first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]) -> float:
    """Above 0 where the way over three points turns left."""
    (x0, y0), (x1, y1), (x2, y2) = first, second, third
    return (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)


def to_frontier(episodes: pd.DataFrame) -> pd.DataFrame:
    """The distance of each arm's agents to the frontier of careful and constant drivers, where there are any.

    The frontier is the lower hull of their crash rate over progress, the distance covered over the time limit. An agent
    slower or faster than all of them has no distance.

    Args:
        episodes: as from `scores.with_outcomes`.

    Returns:
        A row a PLACE, arm and traffic: agents, how many of them have a distance (inside), and their mean crash rate
        above the frontier with its 95 % interval over agents. Exploratory.
    """
    rows = episodes[episodes["tested_on"] == episodes["backend"]]
    rows = rows.assign(progress=rows["distance"] / rows["seconds"], arm=rows["arm"].fillna("").astype(str))
    drivers = rows.groupby([*PLACE, "traffic", "kind", "policy", "arm", "cell"], sort=False)
    drivers = drivers[["progress", "crashed"]].mean().reset_index()
    lines = []
    for (*place, traffic), own in drivers.groupby([*PLACE, "traffic"], sort=False):
        hull = lower_hull(own[own["policy"].isin(RULES)])
        if len(hull) < 2:
            continue
        for arm, agents in own[own["kind"] == "agent"].groupby("arm", sort=False):
            best = np.interp(agents["progress"], hull["progress"], hull["crashed"], left=np.nan, right=np.nan)
            above = (agents["crashed"] - best).dropna()
            spread = float(above.var(ddof=1)) / len(above) if len(above) > 1 else 0.0
            found = interval(
                Mean(float(above.mean()), spread, max(len(above) - 1.0, 1.0), max(len(above), 1))
            )
            limits = found.estimate, found.low, found.high
            lines.append([*place, arm, traffic, len(agents), len(above), *limits])
    return pd.DataFrame(lines, columns=COLUMNS)
