"""From which rate of events on an arm crashes less than control: curves of `analysis.rare`, agent by agent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from experiments.analysis.plan import ALPHA
from experiments.analysis.rare import ENDS

CONTROL, TREATMENT = "control", "treatment"


class BreakEven(NamedTuple):
    """Where the difference of two curves changes its sign; all rates in those of dose 1, NaN where there is none.

    Attributes:
        rate: at which the estimates are equal, between two rates with decided and opposite signs.
        low, high: these rates, between which it lies.
        less: the rates at which treated agents crash less, decided: lowest and highest.
        more: the rates at which they crash more.
    """

    rate: float
    low: float
    high: float
    less: tuple[float, float]
    more: tuple[float, float]


def mean_of_agents(curves: Sequence[pd.DataFrame], per: str) -> pd.DataFrame:
    """The mean of agents' crashes at each rate, with a 95 % interval over agents and episodes.

    Its ends are the wider ones of two intervals: of agents (t, whose estimates contain the chance of their episodes),
    and of episodes alone (the agents' own intervals, as independent ones), which is not zero where nobody crashed.

    Args:
        curves: of `rare.curve` at the same rates, each of other scenarios.
        per: "episode" or "100_km".

    Returns:
        "value", "low" and "high", by rate.
    """
    column = f"crashes_per_{per}"
    value, low, high = (
        np.array([curve.set_index("rate")[f"{column}{end}"] for curve in curves]) for end in ENDS
    )
    mean, n = value.mean(axis=0), len(curves)
    agents = stats.t.ppf(1 - ALPHA / 2, n - 1) * value.std(axis=0, ddof=1) / np.sqrt(n)
    below, above = (np.hypot.reduce(end - value, axis=0) / n for end in (low, high))
    ends = {
        "low": np.maximum(mean - np.maximum(agents, below), 0.0),
        "high": mean + np.maximum(agents, above),
    }
    return pd.DataFrame({"value": mean, **ends}, index=pd.Index(curves[0]["rate"], name="rate"))


def compared(curves: Mapping[str, Sequence[pd.DataFrame]], per: str = "episode") -> pd.DataFrame:
    """Both arms and treatment minus control at each rate, by rate.

    The interval of the difference has the square root of the sum of squares of those of the arms (Zou and Donner 2008).

    Returns:
        "control", "treatment" and "difference", each also with "_low" and "_high".
    """
    control, treated = (mean_of_agents(curves[arm], per) for arm in (CONTROL, TREATMENT))
    difference = treated["value"] - control["value"]
    low = difference - np.hypot(treated["value"] - treated["low"], control["high"] - control["value"])
    high = difference + np.hypot(treated["high"] - treated["value"], control["value"] - control["low"])
    whole = pd.DataFrame({"value": difference, "low": low, "high": high})
    parts = {CONTROL: control, TREATMENT: treated, "difference": whole}
    return pd.concat(
        [part.rename(columns=lambda end, name=name: f"{name}_{end}") for name, part in parts.items()], axis=1
    ).rename(columns=lambda name: name.removesuffix("_value"))


def break_even(found: pd.DataFrame) -> BreakEven:
    """What `compared` says of the rate at which risky training breaks even."""
    rates, difference = np.array(found.index, dtype=float), found["difference"].to_numpy()
    sign = np.where(found["difference_high"] < 0, -1, np.where(found["difference_low"] > 0, 1, 0))
    ends = {side: _ends(rates[sign == side]) for side in (-1, 1)}
    decided = np.flatnonzero(sign)
    changes = [(a, b) for a, b in pairwise(decided) if sign[a] != sign[b]]
    if len(changes) != 1:
        return BreakEven(np.nan, np.nan, np.nan, ends[-1], ends[1])
    first, last = changes[0]
    crossing = next(
        k for k in range(first, last) if difference[k] * sign[first] > 0 >= difference[k + 1] * sign[first]
    )
    share = difference[crossing] / (difference[crossing] - difference[crossing + 1])
    logs = np.log(rates[crossing : crossing + 2])
    rate = float(np.exp(logs[0] + share * (logs[1] - logs[0])))
    return BreakEven(rate, float(rates[first]), float(rates[last]), ends[-1], ends[1])


def _ends(rates: np.ndarray) -> tuple[float, float]:
    return (float(rates.min()), float(rates.max())) if len(rates) else (np.nan, np.nan)
