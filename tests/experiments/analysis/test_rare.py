"""Crash probabilities from episodes whose events came more often, on a made-up road whose probabilities are known."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis import rare

RATES = (1e-4, 1e-2, 1e-1, 1.0)
FATAL, LONGEST = 0.05, 4.0  # chance of an event near the ego; most expected events at the rate 1


def driven(
    rng: np.random.Generator, levels: tuple[float, ...], episodes: int, floor: float = 0.0
) -> pd.DataFrame:
    """Episodes of each component: every event near the ego crashes with the chance FATAL, no event with `floor`."""
    components = [(rate, level) for rate in RATES for level in {rate, *levels} if level >= rate]
    base, level = np.repeat(np.array(components), episodes, axis=0).T
    near_expected, other_expected = rng.uniform(0.5, LONGEST, len(base)), rng.uniform(0.0, 6.0, len(base))
    near, other = rng.poisson(level * near_expected), rng.poisson(base * other_expected)
    crashed = rng.random(len(base)) >= (1.0 - floor) * (1.0 - FATAL) ** near
    km = np.where(crashed, 0.05, 0.1)
    return pd.DataFrame(
        {"base": base, "level": level, "near": near, "near_expected": near_expected, "other": other}
        | {"other_expected": other_expected, "crashed": crashed, "km": km, "steps": 10}
    )


def truth(rate: float, floor: float = 0.0) -> float:
    return float(np.mean(1.0 - (1.0 - floor) * np.exp(-rate * FATAL * np.linspace(0.5, LONGEST, 2001))))


@pytest.mark.parametrize("floor", [0.0, 0.01])
def test_estimates_are_unbiased_and_intervals_cover(floor: float) -> None:
    rng, found = np.random.default_rng(1), []
    for _ in range(200):
        found.append(rare.curve(driven(rng, (0.3, 1.0), 50, floor), (1e-4, 1e-1, 1.0)))
    rows = pd.concat(found)
    for rate, of in rows.groupby("rate"):
        known = truth(rate, floor)
        error = of["crashes_per_episode"].std() / np.sqrt(len(of))
        assert abs(of["crashes_per_episode"].mean() - known) < 4 * error
        covers = of["crashes_per_episode_low"].le(known) & of["crashes_per_episode_high"].ge(known)
        assert covers.mean() >= 0.90  # of 200: 93 % but for three standard errors
        if floor == 0.0:
            by_events = of["by_events_per_episode_low"].le(known) & of["by_events_per_episode_high"].ge(known)
            assert 0.90 <= by_events.mean() <= 0.99
        kilometres = 100.0 * known / (0.1 - 0.05 * known)
        covered = of["crashes_per_100_km_low"].le(kilometres) & of["crashes_per_100_km_high"].ge(kilometres)
        assert covered.mean() >= 0.90


def test_two_mixtures_give_one_curve_and_claim_what_counting_cannot() -> None:
    rng = np.random.default_rng(2)
    curves = [rare.curve(driven(rng, levels, 400), RATES) for levels in ((0.3, 1.0), (0.1, 2.0))]
    first, second = (one["by_events_per_episode"].to_numpy() for one in curves)
    spread = [one["by_events_per_episode_high"] - one["by_events_per_episode_low"] for one in curves]
    assert (np.abs(first - second) < np.hypot(*spread)).all()
    lowest = curves[0].iloc[0]
    assert lowest["claim"] == "by events" and lowest["crashes_without"] == 0
    assert lowest["by_events_per_episode_high"] < 3e-5 < 5e-4 < lowest["without_per_episode_high"] < 1e-2
    assert lowest["crashes_per_episode_high"] > lowest["without_per_episode_high"]


def test_episodes_as_often_as_asked_about_are_counted_plainly() -> None:
    episodes = driven(np.random.default_rng(3), (), 500)
    episodes = episodes[episodes["base"] == 1.0].reset_index(drop=True)
    np.testing.assert_allclose(rare.weights(episodes, 1.0), 1.0)
    row = rare.curve(episodes, (1.0,)).iloc[0]
    assert row["crashes_per_episode"] == pytest.approx(episodes["crashed"].mean())
    assert row["crashes_per_100_km"] == pytest.approx(episodes["crashed"].sum() / episodes["km"].sum() * 100)
    crashed = np.arange(20) < 4
    low = rare.estimate(np.zeros(20, int), np.ones(20), crashed, crashed).low
    variance = crashed.var(ddof=1) / 20
    assert low == pytest.approx(stats.gamma(0.2**2 / variance, scale=variance / 0.2).ppf(0.025))


def test_nothing_is_claimed_of_few_or_of_unequal_crashes() -> None:
    episodes = driven(np.random.default_rng(4), (1.0,), 100)
    none = rare.curve(episodes.assign(crashed=False), RATES)
    assert set(none["claim"]) == {"nothing"} and (none["crashes_per_episode_low"] == 0.0).all()
    assert (none["crashes_per_episode_high"] > 3.0 / len(episodes)).all()
    row = {"crashes_by_events": 50, "effective_crashes": 12.0, "largest_share": 0.3, "crashes_without": 0}
    ends = {
        "without_per_episode_high": 1e-4,
        "by_events_per_episode": 1e-3,
        "by_events_per_episode_high": 2e-3,
    }
    assert rare.claim({**row, **ends}) == "nothing"
    assert rare.claim({**row, **ends, "largest_share": 0.2}) == "all"
    assert rare.claim({**row, **ends, "effective_crashes": 9.0, "largest_share": 0.2}) == "nothing"
    assert rare.claim({**row, **ends, "by_events_per_episode_high": 4e-3, "largest_share": 0.2}) == "nothing"


def test_rare_crashes_by_one_event_are_not_forgotten_beside_many_by_two() -> None:
    """At a low rate the latter hardly count, and say nothing about the former, of which none was seen."""
    episodes = driven(np.random.default_rng(6), (0.3, 1.0), 200)
    episodes["crashed"] = (episodes["near"] >= 2) & (np.arange(len(episodes)) % 5 == 0)
    row = rare.curve(episodes, RATES).iloc[0]
    single = (episodes["near"] == 1).sum()
    events = RATES[0] * episodes["near_expected"].mean()
    assert row["by_events_per_episode_high"] > 2.0 * events / single and row["claim"] == "nothing"
    episodes.loc[(episodes["near"] == 0) & (episodes["other"] > 2), "crashed"] = True  # by events far away
    assert rare.curve(episodes, RATES).iloc[0]["without_per_episode_high"] > 3.0 / len(episodes)


def test_a_pilot_chooses_levels_by_who_is_near() -> None:
    few, many = (pd.DataFrame({"near_expected": [mean, 3 * mean]}) for mean in (0.5, 2.0))
    assert rare.choose(few) == (0.7, 2.0) and rare.choose(many) == pytest.approx((0.7 / 4, 2.0 / 4), rel=0.05)
