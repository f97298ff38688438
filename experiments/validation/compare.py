"""Paired comparison of two simulators on the same scenarios.

The scenario is the unit: the egos that were driven through one are averaged first, so that intervals do not pretend
that they are independent. Intervals are 90 % t-intervals, so that one that lies within a margin shows equivalence
by two one-sided tests at 5 % (Schuirmann 1987). At the intersection, where each simulator drives the three seconds
before an episode itself, two episodes share the seed and not the first scene; the arithmetic is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from experiments.validation.episodes import BIN, BINS, HEADWAYS, PAIR

RESAMPLES = 200
CENTRES = (np.arange(BINS) + 0.5) * BIN  # [s] of the headway histogram
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """First minus second: the means of both, their difference, its 90 % interval (NaN without one), and scenarios."""

    first: float = np.nan
    second: float = np.nan
    difference: float = np.nan
    low: float = np.nan
    high: float = np.nan
    n: int = 0


def pairs(table: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """Episodes that both engines have driven, side by side with suffixes ``_a`` and ``_b``.

    Where the two did not start from the same scenario (stored episodes may be of a version that drew others) there
    is no pair.
    """
    a, b = (table[table["engine"] == name].drop(columns="engine") for name in (first, second))
    both = a.merge(b, on=PAIR, suffixes=("_a", "_b"))
    return both[both["drawn_a"] == both["drawn_b"]]


def interval(values: Floats, confidence: float = 0.90) -> tuple[float, float]:
    """t-interval of the mean; NaN with fewer than two values."""
    if len(values) < 2:
        return np.nan, np.nan
    half = float(stats.t.ppf(0.5 + confidence / 2, len(values) - 1) * stats.sem(values))
    return float(values.mean()) - half, float(values.mean()) + half


def mean_difference(both: pd.DataFrame, measure: str) -> Difference:
    """Difference of the means of a measure; pairs in which either has none do not count."""
    columns = both[["scenario", f"{measure}_a", f"{measure}_b"]].astype(float)
    columns = columns[np.isfinite(columns).all(axis=1)]
    if columns.empty:
        return Difference()
    first, second = columns[f"{measure}_a"], columns[f"{measure}_b"]
    by_scenario = (first - second).groupby(columns["scenario"]).mean().to_numpy()
    centre = float((first - second).mean())
    return Difference(first.mean(), second.mean(), centre, *interval(by_scenario), len(by_scenario))


def same_outcome(both: pd.DataFrame) -> Difference:
    """Share of episodes with the same crash outcome (`first`), against all of them."""
    same = (both["crashed_a"] == both["crashed_b"]).astype(float)
    return mean_difference(both.assign(same_a=same, same_b=1.0), "same")


def wasserstein(first: Floats, second: Floats) -> float:
    """Wasserstein distance [s] of two headway histograms of shape (BINS,); nan if either is empty."""
    if not first.sum() or not second.sum():
        return float("nan")
    return float(np.abs(np.cumsum(first / first.sum()) - np.cumsum(second / second.sum())).sum() * BIN)


def headway_distance(both: pd.DataFrame) -> Difference:
    """Wasserstein distance of the headways, its interval by resampling scenarios; means of both."""
    sides = [both.groupby("scenario")[[f"{name}_{side}" for name in HEADWAYS]].sum() for side in "ab"]
    a, b = (side.to_numpy(float) for side in sides)
    rng = np.random.default_rng(0)
    resampled = []
    for _ in range(RESAMPLES if len(a) > 1 else 0):
        rows = rng.integers(len(a), size=len(a))
        resampled.append(wasserstein(a[rows].sum(axis=0), b[rows].sum(axis=0)))
    low, high = pd.Series(resampled, dtype=float).quantile([0.05, 0.95])
    totals = [side.sum(axis=0) for side in (a, b)]
    first, second = (float(total @ CENTRES / total.sum()) if total.sum() else np.nan for total in totals)
    return Difference(first, second, wasserstein(*totals), low, high, len(a))


def reversed_pairs(both: pd.DataFrame, measure: str) -> tuple[list[str], int]:
    """Pairs of egos that the first simulator puts in the opposite order, among those that the second decides.

    A pair is decided if the 95 % interval of its difference over scenarios excludes 0. Returns the reversed pairs as
    "one / other" and the number of decided ones.
    """
    tables = [
        both.pivot(index="scenario", columns="ego", values=f"{measure}_{side}").astype(float) for side in "ab"
    ]
    turned, decided = [], 0
    for one, other in combinations(tables[1].columns, 2):
        reference = (tables[1][one] - tables[1][other]).dropna().to_numpy()
        low, high = interval(reference, 0.95)
        if len(reference) < 3 or low <= 0 <= high:
            continue
        decided += 1
        if float((tables[0][one] - tables[0][other]).mean()) * float(reference.mean()) < 0:
            turned.append(f"{one} / {other}")
    return turned, decided


def differing(both: pd.DataFrame) -> pd.DataFrame:
    """Pairs that are not one and the same episode: another ending, length, or return (by more than 1e-3)."""
    same = (both["outcome_a"] == both["outcome_b"]) & (both["length_a"] == both["length_b"])
    close = (both["return_a"] - both["return_b"]).abs() <= 1e-3
    return both[~(same & close)]
