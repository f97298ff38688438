"""Crash probabilities at any rate of risk events, from episodes in which they came more often (docs/rare.md).

In an episode of the component (base, level), events came at the rate `base`, and at the rate `level` near the ego;
rates are in units of those at dose 1. At another rate it counts by its likelihood there over that in the mixture of all
components (Owen and Zhou 2000), so that one set of episodes gives the whole curve. Every rate is a component of its own
as well: no weight is larger than the number of components.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats
from scipy.special import logsumexp, xlogy

COMPONENT = ["base", "level"]
NEAR = (0.7, 2.0)  # events near the ego in an episode
# Of a claim: fewest crashes, also counted by their weights; largest share of one; upper end over the estimate.
FEWEST, LARGEST, WIDEST = 10, 0.25, 3.0
TAILS = (0.025, 0.975)
TINY = 1e-300  # no episode is possible
ENDS = ("", "_low", "_high")  # of the columns of an estimate


class Part(NamedTuple):
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float


def log_likelihood(episodes: pd.DataFrame, base: float, level: float) -> np.ndarray:
    """Of the events that came, but for what does not depend on the rates; shape (n,)."""
    columns = ("near", "near_expected", "other", "other_expected")
    near, near_expected, other, other_expected = (episodes[name].to_numpy() for name in columns)
    found = xlogy(near, level) - level * near_expected + xlogy(other, base) - base * other_expected
    return np.asarray(found)


def weights(episodes: pd.DataFrame, rate: float) -> np.ndarray:
    """How much each episode counts at a rate; shape (n,), with the mean 1 but for chance."""
    shares = episodes.groupby(COMPONENT).size() / len(episodes)
    mixed = [log_likelihood(episodes, *component) + np.log(share) for component, share in shares.items()]
    return np.exp(log_likelihood(episodes, rate, rate) - logsumexp(mixed, axis=0))


def estimate(
    strata: np.ndarray, weight: np.ndarray, crashed: np.ndarray, possible: np.ndarray, per: Any = 1.0
) -> Part:
    """Crashes over `per`, with the interval of a gamma distribution (Fay and Feuer 1997).

    Its variance is that within the strata, the numbers of the components. The upper end counts one more crash, of the
    largest weight that one had, and at least of the mean weight of all that may have crashed (`possible`): crashes by
    a single event may be missing among many by two, and only they count at a low rate.
    """
    n, whole = len(weight), float((weight * per).mean())
    value = float((weight * crashed).mean()) / whole
    residual, sizes = weight * (crashed - value * per) / whole, np.bincount(strata)
    deviation = residual - (np.bincount(strata, residual) / sizes)[strata]
    within = np.bincount(strata, deviation**2) / np.maximum(sizes - 1, 1)
    variance = float((sizes * within).sum()) / n**2
    others = weight[possible]
    usual = float((others**2).sum() / max(others.sum(), TINY))
    more = max(float(weight[crashed].max(initial=0.0)), usual) / whole / n
    low = _gamma(TAILS[0], value, variance) if crashed.any() else 0.0
    return Part(value, low, _gamma(TAILS[1], value + more, variance + more**2))


def _gamma(quantile: float, mean: float, variance: float) -> float:
    if not variance:
        return mean
    return float(stats.gamma.ppf(quantile, mean**2 / variance, scale=variance / mean))


def curve(episodes: pd.DataFrame, rates: Sequence[float]) -> pd.DataFrame:
    """A row for each rate: crashes per episode and per 100 km, in parts, and what is claimed about them."""
    crashed, free = episodes["crashed"].to_numpy(), (episodes["near"] == 0).to_numpy()
    by_events, without = crashed & ~free, crashed & free
    strata = episodes.groupby(COMPONENT).ngroup().to_numpy()
    rows = []
    for rate in rates:
        weight = weights(episodes, rate)
        found: dict[str, Any] = {"rate": rate}
        for name, per in (("episode", 1.0), ("100_km", episodes["km"].to_numpy() / 100.0)):
            events = estimate(strata, weight, by_events, ~free, per)
            others = estimate(strata, weight, without, free, per)
            parts = {"by_events": events, "without": others, "crashes": _sum(events, others)}
            for of, part in parts.items():
                found |= {f"{of}_per_{name}{end}": value for end, value in zip(ENDS, part, strict=True)}
        of_events = weight[by_events]
        found |= {
            "crashes_by_events": int(by_events.sum()),
            "crashes_without": int(without.sum()),
            "effective_crashes": _effective(of_events),
            "effective_episodes": _effective(weight),
            "largest_share": float(of_events.max() / of_events.sum()) if of_events.any() else 0.0,
        }
        rows.append({**found, "claim": claim(found)})
    return pd.DataFrame(rows)


def _sum(one: Part, other: Part) -> Part:
    """The sum of two estimates, whose interval has the square root of the sum of squares (Zou and Donner 2008)."""
    value = one.value + other.value
    low, high = (np.hypot(one[k] - one.value, other[k] - other.value) for k in (1, 2))
    return Part(value, float(value - low), float(value + high))


def _effective(weight: np.ndarray) -> float:
    return float(weight.sum() ** 2 / (weight**2).sum()) if weight.any() else 0.0


def claim(row: dict[str, Any]) -> str:
    """What may be said: "all", "by events" (crashes without events may be as many), or "nothing"."""
    enough = min(row["crashes_by_events"], row["effective_crashes"]) >= FEWEST
    is_wide = row["by_events_per_episode_high"] > WIDEST * row["by_events_per_episode"]
    if not enough or is_wide or row["largest_share"] > LARGEST:
        return "nothing"
    unknown = row["without_per_episode_high"] > row["by_events_per_episode"]
    return "by events" if unknown and row["crashes_without"] < FEWEST else "all"


def choose(pilot: pd.DataFrame) -> tuple[float, ...]:
    """Levels at which NEAR events are to be expected near the ego in an episode, by episodes of a pilot.

    Few, because most crashes take one event, and each further one only makes weights unequal; and more for the others.
    """
    return tuple(float(f"{number / pilot['near_expected'].mean():.2g}") for number in NEAR)
