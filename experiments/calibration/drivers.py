"""How far SUMO's regular traffic is from highway-env's, as one number: differences in units of their margins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.validation import checks, compare
from experiments.validation.checks import REFERENCE
from experiments.validation.egos import CORE

if TYPE_CHECKING:
    import pandas as pd

JUDGED = ("traffic_speed", "headway", "return", "crashed", "crashed_ego", "lane_changes")
# Of the share of episodes that end otherwise. It is no target (crossings are decided by centimetres), but it is
# much less noisy than a difference of crash rates, and guides the search where those cannot.
WEIGHT_OF_OUTCOMES = 1.0


def distance(table: pd.DataFrame, engine: str, task: str) -> float:
    """The objective of calibration: 0 if `engine` does in each level what the reference does, about 1 at the margins.

    Args:
        table: episodes of both, in regular traffic, by the egos of `egos.CORE`.
    """
    total = []
    for _, rows in table[table["task"] == task].groupby("level"):
        shares: dict[str, list[float]] = {}
        for item in checks.level_checks(rows, engine, task, "regular"):
            if item["metric"] in JUDGED and item["margin"] and item["difference"] is not None:
                shares.setdefault(item["metric"], []).append(abs(item["difference"]) / item["margin"])
        both = compare.pairs(rows[rows["ego"].isin(CORE)], engine, REFERENCE)
        terms = [sum(values) / len(values) for values in shares.values()]
        terms.append(-WEIGHT_OF_OUTCOMES * compare.same_outcome(both).difference)
        total.append(sum(terms) / len(terms))
    return sum(total) / len(total)
