"""Dose and response: how often egos crash at each dose of risk, in both simulators, and how often they should.

At dose 1 and the lowest traffic level the careful ego shall crash .10 to .30 more often than at dose 0, less at
smaller doses, and careful, IDM and idle egos alike in both simulators. On the two-way road, where nearly everybody
crashes, only the likeness counts.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from experiments.validation.checks import REFERENCE
from experiments.validation.margins import MARGINS

if TYPE_CHECKING:
    import pandas as pd

EGOS = ("careful", "idm", "idle")
DOSES = ("regular", "0.25", "0.5", "0.75", "risky")
SEARCHED = ("regular", "0.5", "risky")  # enough to see a rise
RISE = (0.10, 0.30)  # of the careful ego's crash rate, from dose 0 to dose 1
AIM = (0.15, 0.25)  # well within
WITHOUT_RISE = ("two-way",)


def responses(table: pd.DataFrame) -> pd.DataFrame:
    """Crash rate, time to crash and length of the episodes by engine, task, traffic and ego."""
    grouped = table.groupby(["engine", "task", "traffic", "ego"], sort=False)
    means = grouped.agg(
        crash_rate=("crashed", "mean"), time_to_crash=("crash_time", "mean"), length=("length", "mean"),
        episode_return=("return", "mean"), episodes=("crashed", "size"), wrecks=("wrecks", "sum"),
        hours=("vehicle_hours", "sum"),
    )  # fmt: skip
    means["wrecks_per_vehicle_hour"] = means.pop("wrecks") / means.pop("hours")
    return means.reset_index()


def distance(table: pd.DataFrame, engine: str, task: str) -> float:
    """How far a dose is from what it shall do: 0 if it does, about 1 at the margins.

    Args:
        table: episodes of `engine` and the reference in SEARCHED, by EGOS.
    """
    rates = responses(table[table["task"] == task]).set_index(["engine", "traffic", "ego"])["crash_rate"]
    unlike = [
        abs(float(rates[engine, traffic, ego]) - float(rates[REFERENCE, traffic, ego]))
        / MARGINS["crashed"].value
        for traffic in SEARCHED
        for ego in EGOS
    ]
    total = sum(unlike) / len(unlike)
    if task not in WITHOUT_RISE:
        for side in (engine, REFERENCE):
            careful = [float(rates[side, traffic, "careful"]) for traffic in SEARCHED]
            total += outside(careful[-1] - careful[0], AIM) / RISE[0]
            total += sum(max(before - after, 0.0) for before, after in pairwise(careful)) / RISE[0]
    return total


def outside(value: float, bounds: tuple[float, float]) -> float:
    """How far a value is from an interval."""
    return max(bounds[0] - value, value - bounds[1], 0.0)
