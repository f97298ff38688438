"""Paired comparison of two simulators on the same scenarios.

The scenario is the unit: the egos that were driven through one are averaged first, so that intervals do not pretend
that they are independent. Intervals are 90 % t-intervals, so that one that lies within a margin shows equivalence
by two one-sided tests at 5 % (Schuirmann 1987). At the intersection, where each simulator drives the three seconds
before an episode itself, two episodes share the seed and not the first scene; the arithmetic is the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from experiments.validation.episodes import BIN, BINS, HEADWAYS, PAIR

if TYPE_CHECKING:
    import pandas as pd

CONFIDENCE = 0.90
RESAMPLES = 200
CENTRES = (np.arange(BINS) + 0.5) * BIN  # [s] of the headway histogram
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Difference:
    """First minus second: means of both, their difference and its 90 % interval (None without one), scenarios."""

    first: float
    second: float
    difference: float
    low: float | None
    high: float | None
    n: int


def pairs(table: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """Episodes that both engines have driven, side by side with suffixes ``_a`` and ``_b``.

    Where the two did not start from the same scenario (stored episodes may be of a version that drew others) there
    is no pair; `strangers` counts those.
    """
    both = _side_by_side(table, first, second)
    return both[both["drawn_a"] == both["drawn_b"]]


def strangers(table: pd.DataFrame, first: str, second: str) -> int:
    """Episodes of both engines that bear one number but are of different scenarios."""
    both = _side_by_side(table, first, second)
    return int((both["drawn_a"] != both["drawn_b"]).sum())


def _side_by_side(table: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    a, b = (table[table["engine"] == name].drop(columns="engine") for name in (first, second))
    return a.merge(b, on=PAIR, suffixes=("_a", "_b"))


def interval(values: Floats) -> tuple[float | None, float | None]:
    """90 % t-interval of the mean; (None, None) with fewer than two values."""
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return None, None
    spread = values.std(ddof=1) / np.sqrt(len(values))
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * spread)
    centre = float(values.mean())
    return centre - half, centre + half


def mean_difference(both: pd.DataFrame, measure: str) -> Difference:
    """Difference of the means of a measure; pairs in which either has none are left out."""
    columns = both[["scenario", f"{measure}_a", f"{measure}_b"]].astype(float)
    columns = columns[np.isfinite(columns).all(axis=1)]
    columns["difference"] = columns[f"{measure}_a"] - columns[f"{measure}_b"]
    by_scenario = columns.groupby("scenario")["difference"].mean().to_numpy()
    if not len(by_scenario):
        return Difference(np.nan, np.nan, np.nan, None, None, 0)
    low, high = interval(by_scenario)
    return Difference(
        float(columns[f"{measure}_a"].mean()), float(columns[f"{measure}_b"].mean()),
        float(columns["difference"].mean()), low, high, len(by_scenario),
    )  # fmt: skip


def wrecks_difference(both: pd.DataFrame) -> Difference:
    """Difference of the rates at which other vehicles crash [1/vehicle-hour]; without an interval."""
    first, second = (
        float(wrecks / hours) if hours else np.nan
        for wrecks, hours in (both[[f"wrecks_{side}", f"vehicle_hours_{side}"]].sum() for side in "ab")
    )
    return Difference(first, second, first - second, None, None, both["scenario"].nunique())


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
    low, high = (float(np.nanquantile(resampled, q)) for q in (0.05, 0.95)) if resampled else (None, None)
    first, second = (
        float(side.sum(axis=0) @ CENTRES / side.sum()) if side.sum() else np.nan for side in (a, b)
    )
    return Difference(first, second, wasserstein(a.sum(axis=0), b.sum(axis=0)), low, high, len(a))


def same_outcome(both: pd.DataFrame) -> Difference:
    """Share of episodes with the same crash outcome (`first`), against all of them, and its interval."""
    same = (both["crashed_a"] == both["crashed_b"]).groupby(both["scenario"]).mean().to_numpy(float)
    if not len(same):
        return Difference(np.nan, 1.0, np.nan, None, None, 0)
    share = float(same.mean())
    ends = [None if end is None else end - 1.0 for end in interval(same)]
    return Difference(share, 1.0, share - 1.0, ends[0], ends[1], len(same))


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
        if len(reference) < 3 or not _excludes_zero(reference):
            continue
        decided += 1
        if float((tables[0][one] - tables[0][other]).mean()) * float(reference.mean()) < 0:
            turned.append(f"{one} / {other}")
    return turned, decided


def _excludes_zero(values: Floats) -> bool:
    spread = values.std(ddof=1)
    if spread == 0:
        return bool(values[0] != 0)
    t = abs(values.mean()) / (spread / np.sqrt(len(values)))
    return bool(t > stats.t.ppf(0.975, len(values) - 1))


def differing(both: pd.DataFrame) -> pd.DataFrame:
    """Pairs that are not one and the same episode: another ending, length, or return (by more than 1e-3)."""
    same = (both["outcome_a"] == both["outcome_b"]) & (both["length_a"] == both["length_b"])
    close = (both["return_a"] - both["return_b"]).abs() <= 1e-3
    return both[~(same & close)]
