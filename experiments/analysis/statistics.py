"""Inference with the trained agent as the unit.

What the experiment randomises is the traffic an agent is *trained* in, so the unit is the training seed: the test
episodes of one agent are repeated measures of one unit. All agents of a setting are tested on the same scenarios, which
are a sample too. An interval therefore holds the variance between seeds and the variance between scenarios (as the
analysis of readers and cases in medical imaging does: Gallas 2006); taking episodes as independent instead rejects a
true null hypothesis in more than half of all experiments.

The functions take *scores*: an array (seeds, scenarios) for each arm. `linear` turns them into a `Mean`, `combine` adds
means of independent settings, `interval` gives the `Estimate`. An interval that cannot be had is None with the reason
in words, never NaN and never an exception.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from experiments.analysis.plan import ALPHA, POWER

OK = "ok"
ONE_SEED = "no interval: one seed"
DEGENERATE = "degenerate"
MISSING = "missing"
SATURATED = "no information"
FEW = 10  # crashes in an arm below which its scores say little of their own variance

Scores = NDArray[np.float64]  # (seeds, scenarios)


@dataclass(frozen=True)
class Estimate:
    """A number with its interval, or with the reason why there is none.

    estimate, se, low, high: in the unit of the outcome; se, low, high, p (two-sided, against 0) and df are None unless
    status is "ok". n: units (training seeds) in each arm. status: "ok", "no interval: one seed", "degenerate" (nothing
    varies, e.g. diverged agents), "missing" (an arm without agents), "no information" (every agent of both arms
    crashes in every episode, so that none can be safer).
    """

    estimate: float | None
    low: float | None
    high: float | None
    p: float | None
    df: float | None
    n: tuple[int, ...]
    status: str
    reason: str | None = None
    se: float | None = None


@dataclass(frozen=True)
class Mean:
    """A linear combination of arms' means: its value and the independent parts of its variance.

    parts: (variance, degrees of freedom) each. n: seeds of treatment and control. least: seeds in the smallest arm.
    """

    value: float | None
    parts: tuple[tuple[float, float], ...]
    n: tuple[int, ...]
    least: int

    @property
    def variance(self) -> float:
        """The whole variance."""
        return float(sum(variance for variance, _ in self.parts))

    @property
    def df(self) -> float:
        """Satterthwaite's degrees of freedom."""
        below = sum(variance**2 / df for variance, df in self.parts)
        return float(self.variance**2 / below) if below > 0 else 1.0


def check(scores: Scores) -> Scores:
    """The scores as an array. Raises ValueError if they are not a matrix of finite numbers."""
    array = np.asarray(scores, dtype=np.float64)
    if array.ndim != 2 or not np.isfinite(array).all():
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
    n = tuple(len(scores) for scores, _ in used)
    if min(n) == 0:
        return Mean(None, (), n, 0)
    value = float(sum(weight * scores.mean() for scores, weight in used))
    if min(n) == 1:
        return Mean(value, (), n, 1)
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
            noise += (
                weight**2 * float((rest**2).sum()) / ((seeds - 1) * (scenarios - 1)) / (seeds * scenarios)
            )
    if scenarios > 1:
        between = float(per_scenario.var(ddof=1)) / scenarios
        parts.append((max(between - noise, 0.0), scenarios - 1.0))
    lacking = floor - sum(variance for variance, _ in parts)
    if lacking > 0:
        parts.append((lacking, sum(n) - len(n)))
    return Mean(value, tuple(parts), n, min(n))


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
    """sum of weight x mean of independent settings. Settings with weight 0 do not count, and may be empty."""
    used = [(mean, weight) for mean, weight in zip(means, weights, strict=True) if weight != 0]
    if not used:
        return Mean(None, (), (0, 0), 0)
    n = tuple(sum(counts) for counts in zip(*(mean.n for mean, _ in used), strict=True))
    least = min(mean.least for mean, _ in used)
    if least == 0:
        return Mean(None, (), n, 0)
    value = sum(weight * mean.value for mean, weight in used if mean.value is not None)
    parts = tuple((weight**2 * variance, df) for mean, weight in used for variance, df in mean.parts)
    return Mean(value, parts, n, least)


def interval(mean: Mean, confidence: float = 1 - ALPHA) -> Estimate:
    """The mean with its t interval."""

    def none(status: str, reason: str) -> Estimate:
        return Estimate(mean.value, None, None, None, None, mean.n, status, reason)

    if mean.least == 0 or mean.value is None:
        return none(MISSING, "no trained agent in one of the arms")
    if mean.least == 1:
        found = " and ".join(map(str, mean.n))
        return none(ONE_SEED, f"an interval needs two training seeds in every arm, here {found}")
    se = float(np.sqrt(mean.variance))
    if se <= 1e-12 * max(1.0, abs(mean.value)):
        return none(DEGENERATE, "nothing varies between seeds or scenarios, so no interval can be computed")
    df = mean.df
    half = float(stats.t.ppf(0.5 + confidence / 2, df)) * se
    p = float(2 * stats.t.sf(abs(mean.value) / se, df))
    return Estimate(mean.value, mean.value - half, mean.value + half, p, df, mean.n, OK, None, se)


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


def _adjust(
    p_values: Sequence[float | None], correct: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> list[float | None]:
    known = [p for p in p_values if p is not None]
    adjusted = iter(correct(np.array(known)).tolist() if known else [])
    return [None if p is None else next(adjusted) for p in p_values]


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Holm's adjusted p-values (family-wise error), for confirmatory families; None stays None."""
    return _adjust(p_values, _holm)


def _holm(p_values: NDArray[np.float64]) -> NDArray[np.float64]:
    # statsmodels' multipletests does the same, and collects garbage in every call (40 ms and more); tested against it.
    order = np.argsort(p_values)
    steps = p_values[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty_like(p_values)
    adjusted[order] = np.maximum.accumulate(steps).clip(max=1.0)
    return adjusted


def benjamini_hochberg(p_values: Sequence[float | None]) -> list[float | None]:
    """Benjamini and Hochberg's adjusted p-values (false discovery rate), for exploration; None stays None."""
    return _adjust(p_values, stats.false_discovery_control)


def holm_levels(p_values: Sequence[float], alpha: float = ALPHA) -> list[float]:
    """The level at which Holm's procedure tests each hypothesis; those after the first failure share its level.

    An interval at 1 - level excludes 0 exactly where Holm rejects.
    """
    if not len(p_values):
        return []
    order = np.argsort(p_values, kind="stable")
    levels, steps = np.empty(len(order)), alpha / np.arange(len(order), 0, -1)
    failed = next((k for k, i in enumerate(order) if p_values[i] >= steps[k]), len(order) - 1)
    levels[order] = np.minimum(steps, steps[failed])
    return [float(level) for level in levels]


def at_least(p_values: Sequence[float], alpha: float) -> int:
    """In how many places at least there is an effect, with confidence 1 - alpha (partial conjunction).

    Benjamini and Heller (2008) with Fisher's combination of independent p-values.
    """
    ordered = np.sort(np.asarray(p_values, dtype=np.float64))
    for k in range(len(ordered)):
        if stats.combine_pvalues(np.maximum(ordered[k:], 1e-300), method="fisher").pvalue > alpha:
            return k
    return len(ordered)


def iqm(values: Sequence[float]) -> float:
    """Interquartile mean: the mean of the middle half (Agarwal et al. 2021)."""
    return float(stats.trim_mean(np.asarray(values, dtype=np.float64), 0.25))


def equivalence(mean: Mean, margin: float) -> float | None:
    """p-value of "the arms differ by margin or more" (two one-sided tests); None without an interval."""
    found = interval(mean)
    if found.estimate is None or found.se is None:
        return None
    return float(stats.t.sf((margin - abs(found.estimate)) / found.se, found.df))


def ratio(treatment: Scores, control: Scores) -> Estimate:
    """mean(treatment) / mean(control) - 1 with Fieller's interval, the "percent" of the paper's figure 7.

    Refused (status "degenerate", nothing but the reason) where the control mean is not clearly above 0: near 0 the
    ratio has no bounded interval, and below 0 a better arm would get a negative percentage. p is of the difference.
    """
    difference = linear([(treatment, 1.0), (control, -1.0)])
    found = interval(difference)
    if found.status != OK or found.df is None:
        return found
    of_t, of_c = linear([(treatment, 1.0)]), linear([(control, 1.0)])
    q2 = float(stats.t.ppf(1 - ALPHA / 2, found.df)) ** 2
    t, c = float(treatment.mean()), float(control.mean())
    together = (of_t.variance + of_c.variance - difference.variance) / 2
    a = c**2 - q2 * of_c.variance
    if a <= 0 or c <= 0:
        reason = "the control mean is not clearly above 0, so a percentage of it says nothing"
        return Estimate(None, None, None, None, None, difference.n, DEGENERATE, reason)
    b, d = t * c - q2 * together, t**2 - q2 * of_t.variance
    root = float(np.sqrt(max(b**2 - a * d, 0.0)))
    return Estimate(t / c - 1, (b - root) / a - 1, (b + root) / a - 1, found.p, found.df, found.n, OK)


def detectable(se: float, df: float, alpha: float = ALPHA, power: float = POWER) -> float:
    """The smallest true difference that a two-sided test at alpha with this standard error finds with this power."""
    limit = float(stats.t.ppf(1 - alpha / 2, df))
    if df > 200:
        return (limit + float(stats.norm.ppf(power))) * se

    def lacking(effect: float) -> float:
        return float(stats.nct.sf(limit, df, effect)) - power

    return float(optimize.brentq(lacking, 0.0, 4 * limit + 10)) * se


def seeds_needed(
    mean: Mean, difference: float, alpha: float = ALPHA, power: float = POWER, most: int = 200
) -> int | None:
    """Seeds in each arm with which a difference is found; None if `most` are not enough (or scenarios too few)."""
    if mean.least < 2 or difference <= 0:
        return None
    arms = len(mean.n)
    by_seed = sum(variance * count for (variance, _), count in zip(mean.parts[:arms], mean.n, strict=True))
    other = sum(variance for variance, _ in mean.parts[arms:])

    def enough(seeds: int) -> bool:
        se = float(np.sqrt(by_seed / seeds + other))
        return detectable(se, arms * (seeds - 1), alpha, power) <= difference

    return _first(enough, 2, most)


def _first(holds: Callable[[int], bool], low: int, high: int) -> int | None:
    """The first number for which something that stays true becomes true (bisection)."""
    if not holds(high):
        return None
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if holds(middle) else (middle + 1, high)
    return low
