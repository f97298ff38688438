"""Inference with the trained agent as the unit.

What the experiment randomises is the traffic an agent is *trained* in, so the unit is the training seed: the test
episodes of one agent are repeated measures of one unit. All agents of a setting are tested on the same scenarios, which
are a sample too. An interval therefore holds the variance between seeds and the variance between scenarios (as the
analysis of readers and cases in medical imaging does: Gallas 2006); taking episodes as independent instead rejects a
true null hypothesis in more than half of all experiments.

The functions take *scores*: an array (seeds, scenarios) for each arm. `linear` turns them into a `Mean`, `combine` adds
means of independent settings, `interval` gives the `Estimate`. An interval that cannot be had is NaN with the reason in
`status`, never an exception.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

from experiments.analysis.plan import ALPHA, POWER

OK = "ok"
ONE_SEED = "one seed"  # no interval: it needs two training seeds in every arm
DEGENERATE = "degenerate"  # nothing varies between seeds or scenarios, e.g. diverged agents
SATURATED = "no information"  # every agent of both arms crashes in every episode: none can be safer
FEW = 10  # crashes in an arm below which its scores say little of their own variance

Scores = NDArray[np.float64]  # (seeds, scenarios)


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval, in the unit of the outcome; p is two-sided, against 0.

    All but the estimate is NaN unless status is "ok".
    """

    estimate: float
    status: str
    se: float = np.nan
    df: float = np.nan
    low: float = np.nan
    high: float = np.nan
    p: float = np.nan


@dataclass(frozen=True)
class Mean:
    """A linear combination of arms' means: its value, its variance and the degrees of freedom of that.

    least: training seeds in the smallest arm; with one there is no variance.
    """

    value: float
    variance: float
    df: float
    least: int


def total(parts: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The sum of independent variances (each with degrees of freedom), and Satterthwaite's degrees of freedom."""
    variance = float(sum(part for part, _ in parts))
    below = sum(part**2 / df for part, df in parts)
    return variance, float(variance**2 / below) if below > 0 else 1.0


def check(scores: Scores) -> Scores:
    """The scores as an array. Raises ValueError unless they are a matrix of finite numbers with a row at least."""
    array = np.asarray(scores, dtype=np.float64)
    if array.ndim != 2 or not len(array) or not np.isfinite(array).all():
        raise ValueError(f"expected finite scores (seeds, scenarios), got shape {array.shape}")
    return array


def linear(arms: Sequence[tuple[Scores, float]], floor: float = 0.0) -> Mean:
    """sum of weight x mean over arms that are tested on the same scenarios.

    Variance: between the seeds of each arm, and between scenarios, less the part of the latter that is noise within the
    former (two-way random effects, negative values set to 0).

    Args:
        arms: scores and weight of each arm.
        floor: the least variance that can be true, see `binomial_floor`.
    """
    used = [(check(scores), weight) for scores, weight in arms]
    n = [len(scores) for scores, _ in used]
    value = float(sum(weight * scores.mean() for scores, weight in used))
    if min(n) == 1:
        return Mean(value, 0.0, 1.0, 1)
    parts, noise = [], 0.0
    scenarios = used[0][0].shape[1]
    per_scenario = np.zeros(scenarios)
    for scores, weight in used:
        seeds = len(scores)
        rows, columns = scores.mean(axis=1), scores.mean(axis=0)
        parts.append((weight**2 * float(rows.var(ddof=1)) / seeds, seeds - 1.0))
        per_scenario += weight * columns
        if scenarios > 1:
            rest = scores - rows[:, None] - columns + scores.mean()
            within = float((rest**2).sum()) / ((seeds - 1) * (scenarios - 1))
            noise += weight**2 * within / (seeds * scenarios)
    if scenarios > 1:
        between = float(per_scenario.var(ddof=1)) / scenarios
        parts.append((max(between - noise, 0.0), scenarios - 1.0))
    lacking = floor - sum(variance for variance, _ in parts)
    if lacking > 0:
        parts.append((lacking, float(sum(n) - len(n))))
    return Mean(value, *total(parts), min(n))


def binomial_floor(arms: Sequence[Scores]) -> float:
    """The least variance of a difference of proportions that counts, from the arms that (almost) never or always crash.

    The mean of episodes that do not hinder each other varies at least as much as that of independent ones; with fewer
    than FEW crashes (or episodes without) the scores say little of their own variance. With one of each added to an arm
    (Agresti and Caffo 2000) it is above 0 where no agent crashed at all.
    """
    variance = 0.0
    for scores in arms:
        crashes = float(scores.sum())
        if scores.size and min(crashes, scores.size - crashes) < FEW:
            share = (crashes + 1) / (scores.size + 2)
            variance += share * (1 - share) / scores.size
    return variance


def combine(means: Sequence[Mean], weights: Sequence[float]) -> Mean:
    """sum of weight x mean of independent settings."""
    pairs = list(zip(means, weights, strict=True))
    parts = [(weight**2 * mean.variance, mean.df) for mean, weight in pairs]
    value = float(sum(weight * mean.value for mean, weight in pairs))
    return Mean(value, *total(parts), min(mean.least for mean in means))


def alike(tasks: Sequence[str]) -> list[float]:
    """Weights of settings, given their tasks: every task counts alike, and in a task every level."""
    named = pd.Series(tasks)
    return list(1 / named.nunique() / named.groupby(named).transform("size"))


def interval(mean: Mean, confidence: float = 1 - ALPHA) -> Estimate:
    """The mean with its t interval."""
    if mean.least == 1:
        return Estimate(mean.value, ONE_SEED)
    se = float(np.sqrt(mean.variance))
    if se <= 1e-12 * max(1.0, abs(mean.value)):
        return Estimate(mean.value, DEGENERATE)
    half = float(stats.t.ppf(0.5 + confidence / 2, mean.df)) * se
    p = float(2 * stats.t.sf(abs(mean.value) / se, mean.df))
    return Estimate(mean.value, OK, se, mean.df, mean.value - half, mean.value + half, p)


def equivalence(found: Estimate | pd.DataFrame, margin: float) -> NDArray[np.float64]:
    """p-values of "the arms differ by margin or more" (two one-sided tests); NaN without an interval."""
    p: NDArray[np.float64] = stats.t.sf((margin - abs(found.estimate)) / found.se, found.df)
    return p


def slope_weights(x: Sequence[float]) -> list[float]:
    """Weights w with sum_k w[k] * y[k] = the least-squares slope of y on x.

    Raises:
        ValueError: fewer than two different x.
    """
    array = np.asarray(x, dtype=np.float64)
    centred = array - array.mean()
    if len(array) < 2 or not (centred != 0).any():
        raise ValueError(f"a slope needs at least two different levels, got {list(x)}")
    return [float(w) for w in centred / (centred**2).sum()]


def adjusted(p_values: ArrayLike, method: str = "holm") -> NDArray[np.float64]:
    """p-values adjusted by Holm ("holm") or Benjamini and Hochberg ("bh"); NaN stays NaN and does not count.

    Holm's in two lines: scipy has none, and that of statsmodels searches all memory for garbage at each call.
    """
    p = pd.Series(np.asarray(p_values, dtype=np.float64))
    known = p.dropna().sort_values()
    if method == "holm":
        known = (known * np.arange(len(known), 0, -1)).cummax().clip(upper=1.0)
    elif len(known):
        known[:] = stats.false_discovery_control(known)
    return known.reindex(p.index).to_numpy()


def detectable(se: float, df: float, alpha: float = ALPHA, power: float = POWER) -> float:
    """The smallest true difference that a two-sided test at alpha with this standard error finds with this power."""
    limit = float(stats.t.ppf(1 - alpha / 2, df))
    if df > 200:
        return (limit + float(stats.norm.ppf(power))) * se

    def lacking(effect: float) -> float:
        return float(stats.nct.sf(limit, df, effect)) - power

    return float(optimize.brentq(lacking, 0.0, 4 * limit + 10)) * se
