"""What calibration makes small: how far SUMO's traffic, and what a dose of risk does, are from what they should be.

`drivers` takes SUMO's regular traffic against highway-env's. `doses` takes the crash rates at several doses: at dose 1
and the lowest traffic level the careful ego shall crash .10 to .30 more often than at dose 0, less at smaller doses,
and careful, IDM and idle egos alike in both simulators. On the two-way road, where nearly everybody crashes, only the
likeness counts.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from experiments.validation import checks, compare
from experiments.validation.checks import MARGINS, REFERENCE
from experiments.validation.egos import CORE

if TYPE_CHECKING:
    import pandas as pd

JUDGED = ("traffic_speed", "headway", "return", "crashed", "crashed_ego", "lane_changes")
EGOS = ("careful", "idm", "idle")  # of the doses
DOSES = ("regular", "0.25", "0.5", "0.75", "risky")
SEARCHED = ("regular", "0.5", "risky")  # enough to see a rise
RISE = 0.10  # least rise of the careful ego's crash rate from dose 0 to dose 1
AIM = (0.15, 0.25)  # of that rise, well within .10 to .30
WITHOUT_RISE = ("two-way",)


def drivers(table: pd.DataFrame, engine: str, task: str) -> float:
    """0 if `engine` does in each level what the reference does, about 1 at the margins.

    The share of episodes that end otherwise is a term, too. It is no target (crossings are decided by centimetres), but
    it is much less noisy than a difference of crash rates, and guides the search where those cannot.

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
        terms.append(-compare.same_outcome(both).difference)
        total.append(sum(terms) / len(terms))
    return sum(total) / len(total)


def responses(table: pd.DataFrame) -> pd.DataFrame:
    """Crash rate, time to crash and length of the episodes by engine, task, traffic and ego."""
    means = table.groupby(["engine", "task", "traffic", "ego"], sort=False).agg(
        crash_rate=("crashed", "mean"),
        time_to_crash=("crash_time", "mean"),
        length=("length", "mean"),
        episode_return=("return", "mean"),
        episodes=("crashed", "size"),
        wrecks=("wrecks", "sum"),
        hours=("vehicle_hours", "sum"),
    )
    means["wrecks_per_vehicle_hour"] = means.pop("wrecks") / means.pop("hours")
    return means.reset_index()


def doses(table: pd.DataFrame, engine: str, task: str) -> float:
    """0 if a dose does what it shall, about 1 at the margins.

    Args:
        table: episodes of `engine` and the reference in SEARCHED, by EGOS.
    """
    rates = responses(table[table["task"] == task]).set_index(["engine", "traffic", "ego"])["crash_rate"]
    unlike = [
        abs(float(rates[engine, traffic, ego]) - float(rates[REFERENCE, traffic, ego]))
        for traffic in SEARCHED
        for ego in EGOS
    ]
    total = sum(unlike) / len(unlike) / MARGINS["crashed"].value
    if task not in WITHOUT_RISE:
        for side in (engine, REFERENCE):
            careful = [float(rates[side, traffic, "careful"]) for traffic in SEARCHED]
            rise = careful[-1] - careful[0]
            total += max(AIM[0] - rise, rise - AIM[1], 0.0) / RISE
            total += sum(max(before - after, 0.0) for before, after in pairwise(careful)) / RISE
    return total
