"""Paired comparison of two simulators on the same scenarios.

The scenario is the unit: the egos that were driven through one are averaged first, so that intervals do not
pretend that they are independent. Intervals are 90 % t-intervals, so that one that lies within +-margin shows
equivalence by two one-sided tests at 5 % (Schuirmann 1987).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from experiments.validation.episodes import BIN, BINS

if TYPE_CHECKING:
    import pandas as pd

CONFIDENCE = 0.90
RESAMPLES = 200
PAIR = ["task", "level", "traffic", "policy", "scenario"]


@dataclass(frozen=True)
class Difference:
    """First minus second: means of both, their difference and its 90 % interval (None where there is none)."""

    first: float
    second: float
    difference: float
    low: float | None
    high: float | None
    n: int


def pairs(table: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
    """Episodes that both engines have driven, side by side with suffixes ``_a`` and ``_b``.

    Where the two did not start from the same scenario (the stored reference is of an earlier version that drew
    others) there is no pair; `strangers` counts those.
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


def interval(values: NDArray[np.float64]) -> tuple[float | None, float | None]:
    """90 % t-interval of the mean; (None, None) with fewer than two values."""
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return None, None
    half = float(
        stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
    )
    centre = float(values.mean())
    return centre - half, centre + half


def mean_difference(both: pd.DataFrame, measure: str) -> Difference:
    """Difference of the means of a measure; pairs in which either has none are left out."""
    columns = both[["scenario", f"{measure}_a", f"{measure}_b"]].astype(float).dropna()
    columns["difference"] = columns[f"{measure}_a"] - columns[f"{measure}_b"]
    by_scenario = columns.groupby("scenario")["difference"].mean().to_numpy()
    if not len(by_scenario):
        return Difference(np.nan, np.nan, np.nan, None, None, 0)
    low, high = interval(by_scenario)
    return Difference(
        float(columns[f"{measure}_a"].mean()), float(columns[f"{measure}_b"].mean()),
        float(columns["difference"].mean()), low, high, len(by_scenario),
    )  # fmt: skip


def histogram(values: pd.Series) -> NDArray[np.float64]:
    """Sum of the headway histograms of some episodes, shape (BINS,)."""
    return np.sum(np.stack(values.to_list()), axis=0).astype(float) if len(values) else np.zeros(BINS)


def wasserstein(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Wasserstein distance [s] of two headway histograms; nan if either is empty."""
    if not first.sum() or not second.sum():
        return float("nan")
    return float(np.abs(np.cumsum(first / first.sum()) - np.cumsum(second / second.sum())).sum() * BIN)


def headway_distance(both: pd.DataFrame) -> Difference:
    """Wasserstein distance of the headways, its interval by resampling scenarios; means of both."""
    a, b = histogram(both["headways_a"]), histogram(both["headways_b"])
    centres = (np.arange(BINS) + 0.5) * BIN
    by_scenario = {
        scenario: (histogram(group["headways_a"]), histogram(group["headways_b"]))
        for scenario, group in both.groupby("scenario")
    }
    scenarios = list(by_scenario)
    rng = np.random.default_rng(0)
    resampled = []
    for _ in range(RESAMPLES if len(scenarios) > 1 else 0):
        chosen = [by_scenario[scenarios[k]] for k in rng.integers(len(scenarios), size=len(scenarios))]
        resampled.append(wasserstein(*(np.sum([pair[k] for pair in chosen], axis=0) for k in (0, 1))))
    low, high = (float(np.nanquantile(resampled, q)) for q in (0.05, 0.95)) if resampled else (None, None)
    return Difference(
        float((a * centres).sum() / a.sum()) if a.sum() else np.nan,
        float((b * centres).sum() / b.sum()) if b.sum() else np.nan,
        wasserstein(a, b), low, high, len(scenarios),
    )  # fmt: skip


def agreement(both: pd.DataFrame) -> tuple[float, tuple[float | None, float | None]]:
    """Share of episodes with the same crash outcome, and its interval."""
    same = (both["crashed_a"] == both["crashed_b"]).groupby(both["scenario"]).mean().to_numpy(float)
    return (float(same.mean()) if len(same) else float("nan")), interval(same)


def order(both: pd.DataFrame, measure: str) -> tuple[float, int]:
    """Share of pairs of egos that both simulators put in the same order, among those that the second decides.

    A pair is decided if the 95 % interval of its difference over scenarios excludes 0. Also their number.
    """
    tables = [both.pivot(index="scenario", columns="policy", values=f"{measure}_{side}") for side in "ab"]
    agreed, decided = 0, 0
    for one, other in combinations(tables[1].columns, 2):
        reference = (tables[1][one].astype(float) - tables[1][other].astype(float)).dropna().to_numpy()
        if len(reference) < 3 or not _excludes_zero(reference):
            continue
        own = float((tables[0][one].astype(float) - tables[0][other].astype(float)).mean())
        decided += 1
        agreed += own * float(reference.mean()) >= 0
    return (agreed / decided if decided else 1.0), decided


def _excludes_zero(values: NDArray[np.float64]) -> bool:
    spread = values.std(ddof=1)
    if spread == 0:
        return bool(values[0] != 0)
    t = abs(values.mean()) / (spread / np.sqrt(len(values)))
    return bool(t > stats.t.ppf(0.975, len(values) - 1))
