"""Inference with the trained agent as the unit.

What the experiment randomises is the traffic an agent is *trained* in, so the unit of analysis is the
training seed: the test episodes of one agent are repeated measures of one unit and are averaged before
anything is compared. Treating them as independent rejects a true null hypothesis in more than half of all A/A
experiments instead of 5 % (tests/experiments/test_statistics.py repeats that).

Every function takes plain sequences of *seed means* (one number per trained agent) and returns an
`Estimate` or a number. An interval that cannot be had is `None` with the reason in words, never a NaN and
never an exception.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from statsmodels.stats.power import TTestIndPower
from statsmodels.stats.weightstats import ttost_ind

ALPHA = 0.05
OK = "ok"
ONE_SEED = "no interval: one seed"
DEGENERATE = "degenerate"
MISSING = "missing"

Values = Sequence[float] | NDArray[np.float64]


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % interval, or with the reason why there is none.

    estimate, low, high: in the unit of the outcome; low, high, p (two-sided, against 0) and df are None
    unless status is "ok". n: units (training seeds) in each group. status: "ok", "no interval: one seed",
    "degenerate" (an arm whose seeds do not differ at all, e.g. diverged agents), "missing" (a group without
    units).
    """

    estimate: float | None
    low: float | None
    high: float | None
    p: float | None
    df: float | None
    n: tuple[int, ...]
    status: str
    reason: str | None = None

    @property
    def direction(self) -> int:
        """+1 or -1 where the interval excludes 0, otherwise 0."""
        if self.low is None or self.high is None:
            return 0
        return int(self.low > 0) - int(self.high < 0)


def _array(values: Values) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1 or not np.isfinite(array).all():
        raise ValueError(f"expected a flat sequence of finite seed means, got shape {array.shape}: {array!r}")
    return array


def is_constant(values: Values) -> bool:
    """True when the values do not differ beyond rounding, i.e. their standard deviation is 0."""
    array = _array(values)
    return bool(np.ptp(array) <= 1e-12 * max(1.0, float(np.abs(array).max())))


def _no_interval(
    groups: Sequence[NDArray[np.float64]],
    estimate: float | None,
    spread_in: Callable[[Iterable[bool]], bool] = all,
) -> Estimate | None:
    """The Estimate without interval that these groups call for, or None where an interval can be computed.

    spread_in: whether `all` groups must have spread or `any`.
    """
    n = tuple(len(group) for group in groups)
    if min(n) == 0:
        return Estimate(None, None, None, None, None, n, MISSING, "no trained agent in one of the arms")
    if min(n) == 1:
        found = " and ".join(map(str, n))
        reason = f"an interval needs two training seeds in every arm, here {found}"
        return Estimate(estimate, None, None, None, None, n, ONE_SEED, reason)
    if not spread_in(not is_constant(group) for group in groups):
        reason = "the standard deviation between seeds is 0 in an arm, so no interval can be computed from it"
        return Estimate(estimate, None, None, None, None, n, DEGENERATE, reason)
    return None


def welch(treatment: Values, control: Values, confidence: float = 1 - ALPHA) -> Estimate:
    """Mean of treatment minus mean of control, Welch's t interval (unequal variances) on seed means."""
    t, c = _array(treatment), _array(control)
    difference = float(t.mean() - c.mean()) if len(t) and len(c) else None
    if (none := _no_interval((t, c), difference)) is not None:
        return none
    test = stats.ttest_ind(t, c, equal_var=False)
    interval = test.confidence_interval(confidence)
    return Estimate(
        difference,
        float(interval.low),
        float(interval.high),
        float(test.pvalue),
        float(test.df),
        (len(t), len(c)),
        OK,
    )


def paired(
    treatment: Mapping[int, float], control: Mapping[int, float], confidence: float = 1 - ALPHA
) -> Estimate:
    """Treatment minus control within each training seed of both arms (seed -> seed mean), paired t interval.

    Secondary: the two agents of a seed share initial weights and training scenarios, but training
    decorrelates them, and where the correlation is 0 pairing only loses degrees of freedom.
    """
    seeds = sorted(set(treatment) & set(control))
    t, c = _array([treatment[s] for s in seeds]), _array([control[s] for s in seeds])
    difference = float((t - c).mean()) if seeds else None
    if (none := _no_interval((t - c,), difference)) is not None:
        return replace(none, n=(len(seeds), len(seeds)))
    test = stats.ttest_rel(t, c)
    interval = test.confidence_interval(confidence)
    bounds = float(interval.low), float(interval.high)
    return Estimate(difference, *bounds, float(test.pvalue), float(test.df), (len(seeds), len(seeds)), OK)


def contrast(groups: Sequence[Values], weights: Sequence[float], confidence: float = 1 - ALPHA) -> Estimate:
    """sum_k weights[k] * mean(groups[k]) of independent groups with unequal variances.

    Welch-Satterthwaite degrees of freedom; with two groups and weights (1, -1) it is Welch's t. Groups with
    weight 0 are left out, so they may be empty. A group without spread counts as known exactly, because
    leaving it out (agents that never crash) would bias the sum; "degenerate" only if no group has any.
    """
    if len(groups) != len(weights):
        raise ValueError(f"{len(groups)} groups but {len(weights)} weights")
    used = [(_array(g), float(w)) for g, w in zip(groups, weights, strict=True) if w != 0]
    arrays = [array for array, _ in used]
    value = float(sum(w * a.mean() for a, w in used)) if all(len(a) for a in arrays) else None
    if (none := _no_interval(arrays, value, any)) is not None:
        return none
    assert value is not None
    parts = np.array([w**2 * a.var(ddof=1) / len(a) for a, w in used])
    df = float(parts.sum() ** 2 / sum(part**2 / (len(a) - 1) for part, a in zip(parts, arrays, strict=True)))
    se = float(np.sqrt(parts.sum()))
    half = float(stats.t.ppf(0.5 + confidence / 2, df)) * se
    p = float(2 * stats.t.sf(abs(value) / se, df))
    return Estimate(value, value - half, value + half, p, df, tuple(len(a) for a in arrays), OK)


def pooled(strata: Sequence[tuple[Values, Values]]) -> Estimate:
    """Mean over strata (cells of the grid) of treatment minus control; every stratum weighs the same.

    Fixed effects, variance from the seeds within strata. Equal weights and not inverse variances: with a
    handful of seeds an estimated variance is itself uncertain by a factor of 2-4, and a degenerate cell
    would take all.
    """
    if not strata:
        return Estimate(None, None, None, None, None, (0, 0), MISSING, "no comparison to pool")
    groups = [values for pair in strata for values in pair]
    result = contrast(groups, [sign / len(strata) for _ in strata for sign in (1, -1)])
    return replace(result, n=(sum(len(t) for t, _ in strata), sum(len(c) for _, c in strata)))


def slope_weights(x: Sequence[float]) -> list[float]:
    """Weights w with sum_k w[k] * y[k] = the least-squares slope of y on x.

    Raises:
        ValueError: fewer than two different x.
    """
    array = _array(x)
    centred = array - array.mean()
    if len(array) < 2 or is_constant(array):
        raise ValueError(f"a slope needs at least two different levels, got {list(x)}")
    return [float(w) for w in centred / (centred**2).sum()]


def effect_slope(x: Sequence[float], strata: Sequence[tuple[Values, Values]]) -> Estimate:
    """Change of (treatment minus control) per unit of x, e.g. per traffic level.

    strata[k]: seed means of (treatment, control) at x[k].
    """
    weights = slope_weights(x)
    groups = [values for pair in strata for values in pair]
    return contrast(groups, [sign * w for w in weights for sign in (1, -1)])


def mean_slope(x: Sequence[float], strata: Sequence[tuple[Values, Values]]) -> Estimate:
    """Change of the outcome itself per unit of x, averaged over the two arms; strata as in `effect_slope`."""
    weights = slope_weights(x)
    groups = [values for pair in strata for values in pair]
    return contrast(groups, [w / 2 for w in weights for _ in (0, 1)])


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


def iqm(values: Values) -> float:
    """Interquartile mean: the mean of the middle half (Agarwal et al. 2021)."""
    return float(stats.trim_mean(_array(values), 0.25))


def equivalence(treatment: Values, control: Values, margin: float) -> float | None:
    """p-value of "the arms differ by margin or more" (two one-sided Welch tests); small means equivalent.

    None where no interval can be had either.
    """
    t, c = _array(treatment), _array(control)
    if _no_interval((t, c), None) is not None:
        return None
    return float(ttost_ind(t, c, -margin, margin, usevar="unequal")[0])


def ratio(treatment: Values, control: Values) -> Estimate:
    """mean(treatment) / mean(control) - 1 with Fieller's interval, the "percent" of the paper's figure 7.

    Refused (status "degenerate", nothing but the reason) where the control mean is not clearly different
    from 0: the ratio then has no bounded interval and its value says nothing. p is of the difference
    (Welch).
    """
    difference = welch(treatment, control)
    if difference.status != OK:
        return difference
    t, c = _array(treatment), _array(control)
    df = difference.df
    assert df is not None
    q = float(stats.t.ppf(1 - ALPHA / 2, df))
    variance_t, variance_c = float(t.var(ddof=1) / len(t)), float(c.var(ddof=1) / len(c))
    mean_t, mean_c = float(t.mean()), float(c.mean())
    a = mean_c**2 - q**2 * variance_c
    if a <= 0:
        reason = "the control mean is not clearly different from 0, so a ratio to it says nothing"
        return Estimate(None, None, None, None, None, difference.n, DEGENERATE, reason)
    b, d = mean_t * mean_c, mean_t**2 - q**2 * variance_t
    root = float(np.sqrt(max(b**2 - a * d, 0.0)))
    low, high = (b - root) / a - 1, (b + root) / a - 1
    return Estimate(mean_t / mean_c - 1, low, high, difference.p, df, difference.n, OK)


def detectable(treatment: Values, control: Values, power: float = 0.8) -> float | None:
    """The smallest true difference that so many seeds of such a spread would detect with the given power."""
    t, c = _array(treatment), _array(control)
    if _no_interval((t, c), None) is not None:
        return None
    sd = float(np.sqrt((t.var(ddof=1) + c.var(ddof=1)) / 2))
    effect = TTestIndPower().solve_power(nobs1=len(t), ratio=len(c) / len(t), alpha=ALPHA, power=power)
    return float(effect) * sd
