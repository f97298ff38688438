"""Inference with the trained agent as the unit.

What the experiment randomises is the traffic an agent is *trained* in, so the unit is the training seed: the test
episodes of one agent are repeated measures of one unit. All agents of a setting are tested on the same scenarios, which
are a sample too. An interval therefore holds the variance between seeds and the variance between scenarios (as the
analysis of readers and cases in medical imaging does: Gallas 2006); taking episodes as independent instead rejects a
true null hypothesis in more than half of all experiments.

`linear` turns *scores*, an array (seeds, scenarios) for each arm, into a `Mean`; `interval` gives the `Estimate`, of
one mean or of columns of them. An interval that cannot be had is NaN with the reason in `status`, never an exception.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from pandas.api.typing import SeriesGroupBy
from scipy import optimize, stats

from experiments.analysis.plan import ALPHA, POWER

OK = "ok"
ONE_SEED = "one seed"  # no interval: it needs two training seeds in every arm
DEGENERATE = "degenerate"  # nothing varies between seeds or scenarios, e.g. diverged agents
SATURATED = "no information"  # every agent of both arms crashes in every episode: none can be safer
FEW = 10  # crashes in an arm below which its scores say little of their own variance

Scores = NDArray[np.float64]  # (seeds, scenarios)


class Mean(NamedTuple):
    """A linear combination of arms' means, its variance and the degrees of freedom of that.

    smallest: training seeds in the smallest arm; with one there is no variance.
    """

    estimate: Any
    variance: Any
    dof: Any
    smallest: Any


class Estimate(NamedTuple):
    """A number with its 95 % interval, in the unit of the outcome; p is two-sided, against 0.

    All but the estimate is NaN unless status is "ok".
    """

    estimate: Any
    se: Any = np.nan
    df: Any = np.nan
    low: Any = np.nan
    high: Any = np.nan
    p: Any = np.nan
    status: Any = OK


def linear(arms: Sequence[tuple[Scores, float]], floor: float = 0.0) -> Mean:
    """sum of weight x mean over arms that are tested on the same scenarios.

    Variance: between the seeds of each arm, and between scenarios, less the part of the latter that is noise within the
    former (two-way random effects, negative values set to 0); degrees of freedom: Satterthwaite's.

    Args:
        arms: scores and weight of each arm.
        floor: the least variance that can be true, see `binomial_floor`.

    Raises:
        ValueError: scores that are no numbers.
    """
    value = float(sum(weight * scores.mean() for scores, weight in arms))
    if not np.isfinite(value):
        raise ValueError("expected finite scores: an outcome of an episode is no number")
    n = [len(scores) for scores, _ in arms]
    if min(n) == 1:
        return Mean(value, 0.0, 1.0, 1)
    parts, noise = [], 0.0
    scenarios = arms[0][0].shape[1]
    per_scenario = np.zeros(scenarios)
    for scores, weight in arms:
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
    variance = float(sum(part for part, _ in parts))
    below = sum(part**2 / dof for part, dof in parts)
    return Mean(value, variance, variance**2 / below if below > 0 else 1.0, min(n))


def mean_of_units(values: SeriesGroupBy) -> pd.DataFrame:
    """The mean of values in each group, one of each unit, as rows with the columns of `Mean`; NaN does not count."""
    rows = values.agg(estimate="mean", variance="sem", smallest="count").reset_index()
    smallest = rows["smallest"].clip(lower=1)
    return rows.assign(
        variance=rows["variance"].fillna(0.0) ** 2, dof=(smallest - 1).clip(lower=1), smallest=smallest
    )


def binomial_floor(tables: Sequence[Scores] | NDArray[np.float64]) -> float:
    """Lower bound for the variance of a difference of crash rates when an arm has almost no, or almost only, crashes.

    A mean of episodes has at least the variance of independent episodes. With fewer than FEW crashes (or fewer than FEW
    episodes without a crash) the sample variance is unreliable. With one of each added to an arm
    (Agresti and Caffo 2000) it is above 0 where no agent crashed at all.
    """
    size = np.asarray(tables[0]).size
    crashes = np.sum(tables, axis=(1, 2))
    share = (crashes + 1) / (size + 2)
    return float((share * (1 - share) / size)[np.minimum(crashes, size - crashes) < FEW].sum())


def interval(mean: Mean) -> Estimate:
    """A mean, or each of columns of means, with its t interval."""
    se = np.sqrt(mean.variance)
    same = se <= 1e-12 * np.maximum(1.0, np.abs(mean.estimate))
    status = np.select([np.equal(mean.smallest, 1), same], [ONE_SEED, DEGENERATE], OK)
    se, df = (np.where(status == OK, values, np.nan) for values in (se, mean.dof))
    half = stats.t.ppf(1 - ALPHA / 2, df) * se
    p = 2 * stats.t.sf(np.abs(mean.estimate) / se, df)
    return Estimate(mean.estimate, se, df, mean.estimate - half, mean.estimate + half, p, status)


def combine(means: pd.DataFrame, by: Sequence[str], weights: pd.Series) -> pd.DataFrame:
    """sum of weight x mean over the independent settings of each group.

    Args:
        means: a row a setting, with the columns of `Mean`. by: the columns of a group.

    Returns:
        A row a group: `by`, the columns of `Mean` and `Estimate`, settings (their number), and of columns whose names
        begin with mean_ the same sums, of those with seeds_ sums without weights.
    """
    parts = means.filter(regex="^(estimate|mean_)").mul(weights, axis=0)
    parts = parts.join(means.filter(regex="^(smallest|seeds_)"))
    parts = parts.assign(variance=weights**2 * means["variance"], settings=1)
    parts["dof"] = parts["variance"] ** 2 / means["dof"]
    how = dict.fromkeys(parts, "sum") | {"smallest": "min"}
    sums = parts.groupby([means[name] for name in by], sort=False).agg(how)
    sums["dof"] = (sums["variance"] ** 2 / sums["dof"]).fillna(1.0)  # Satterthwaite
    return with_intervals(sums.reset_index())


def with_intervals(means: pd.DataFrame) -> pd.DataFrame:
    """The rows, which have the columns of `Mean`, with the columns of `Estimate` added."""
    return means.assign(**interval(Mean(*(means[name].astype(float) for name in Mean._fields)))._asdict())


def equal_task_weights(rows: pd.DataFrame, by: Sequence[str]) -> pd.Series:
    """Weights of settings: in each group of `by` every task counts alike, and in a task every level."""
    tasks = rows.groupby([*by], sort=False)["task"].transform("nunique")
    return 1 / tasks / rows.groupby([*by, "task"], sort=False)["task"].transform("size")


def slope_weights(rows: pd.DataFrame, by: Sequence[str]) -> pd.Series:
    """Weights with which a sum is the least-squares slope over the levels, in each group of `by`."""
    centred = rows["level"] - rows.groupby([*by])["level"].transform("mean")
    return centred / (centred**2).groupby([rows[name] for name in by]).transform("sum")


def equivalence(found: Estimate | pd.DataFrame, margin: float) -> NDArray[np.float64]:
    """p-values of "the arms differ by margin or more" (two one-sided tests); NaN without an interval."""
    return stats.t.sf((margin - abs(found.estimate)) / found.se, found.df)


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


def detectable(se: float, df: float, alpha: float) -> float:
    """The smallest true difference that a two-sided test at alpha with this standard error finds with POWER."""
    if np.isnan(se):
        return np.nan
    limit = float(stats.t.ppf(1 - alpha / 2, df))
    if df > 200:
        return (limit + float(stats.norm.ppf(POWER))) * se

    def lacking(effect: float) -> float:
        return float(stats.nct.sf(limit, df, effect)) - POWER

    return float(optimize.brentq(lacking, 0.0, 4 * limit + 10)) * se
