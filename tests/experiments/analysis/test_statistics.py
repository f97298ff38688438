"""Estimates, intervals and their error rates on data whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW, ttost_ind

from experiments.analysis import statistics

# A/A data as measured on trained agents at worst: seeds differ with SD 1, episodes of one agent with SD 3.
SEED_SD, EPISODE_SD, EPISODES = 1.0, 3.0, 100


def within(share: float, expected: float, repeats: int, sigmas: float = 4) -> bool:
    """Whether a share of `repeats` agrees with the expected one within `sigmas` standard errors."""
    return abs(share - expected) < sigmas * np.sqrt(expected * (1 - expected) / repeats)


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(20)


def arms_without_effect(random: np.random.Generator, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Episodes (seeds, EPISODES) of two arms that do not differ, on shared test scenarios."""
    scenario = random.normal(0, EPISODE_SD / np.sqrt(2), EPISODES)
    noise = random.normal(0, EPISODE_SD / np.sqrt(2), (2, seeds, EPISODES))
    agents = random.normal(0, SEED_SD, (2, seeds, 1))
    treatment, control = scenario + noise + agents
    return treatment, control


class TestWelch:
    def test_equals_statsmodels(self, random: np.random.Generator) -> None:
        t, c = random.normal(1, 2, 7), random.normal(0, 1, 5)
        result = statistics.welch(t, c)
        other = CompareMeans(DescrStatsW(t), DescrStatsW(c))
        _, p, df = other.ttest_ind(usevar="unequal")
        low, high = other.tconfint_diff(usevar="unequal")
        assert result.estimate == pytest.approx(t.mean() - c.mean())
        assert (result.low, result.high, result.p, result.df) == pytest.approx((low, high, p, df))
        assert result.n == (7, 5)
        assert result.status == "ok"

    @pytest.mark.parametrize(("t", "c"), [([1.0], [0.0]), ([1.0, 2.0], [0.0]), ([1.0], [0.0, 3.0])])
    def test_one_seed_gives_no_interval(self, t: list[float], c: list[float]) -> None:
        result = statistics.welch(t, c)
        assert result.status == "no interval: one seed"
        assert (result.low, result.high, result.p, result.df) == (None, None, None, None)
        assert result.estimate == pytest.approx(np.mean(t) - np.mean(c))
        assert "two training seeds" in str(result.reason)

    def test_arm_without_spread_is_degenerate(self) -> None:
        """Diverged agents all behave alike: an effect of exactly 0 with a spread of 0 is no finding."""
        pairs = [([13.84] * 3, [13.84] * 3), ([0.1 + 0.2] * 3, [1.0, 2.0, 3.0]), ([1.0, 2.0], [5.0, 5.0])]
        for t, c in pairs:
            result = statistics.welch(t, c)
            assert result.status == "degenerate"
            assert result.low is None and result.p is None
            assert "standard deviation" in str(result.reason)

    def test_missing_arm(self) -> None:
        assert statistics.welch([], [1.0, 2.0]).status == "missing"

    def test_refuses_values_that_are_not_numbers(self) -> None:
        with pytest.raises(ValueError, match="finite"):
            statistics.welch([1.0, float("nan")], [1.0, 2.0])

    def test_direction_needs_an_interval_without_zero(self) -> None:
        assert statistics.welch([5.0, 5.1, 5.2], [1.0, 1.1, 1.2]).direction == 1
        assert statistics.welch([1.0, 1.1, 1.2], [5.0, 5.1, 5.2]).direction == -1
        assert statistics.welch([1.0, 9.0], [2.0, 7.0]).direction == 0
        assert statistics.welch([5.0], [1.0]).direction == 0


class TestErrorRates:
    """What the interval promises, checked on repeated experiments; bounds at 4 standard errors."""

    @pytest.mark.parametrize("seeds", [5, 10])
    def test_false_positives_are_five_percent(self, random: np.random.Generator, seeds: int) -> None:
        repeats = 1500
        rejected = 0
        for _ in range(repeats):
            t, c = arms_without_effect(random, seeds)
            rejected += abs(statistics.welch(t.mean(axis=1), c.mean(axis=1)).direction)
        assert within(rejected / repeats, 0.05, repeats)

    def test_coverage_is_95_percent_with_unequal_spread(self, random: np.random.Generator) -> None:
        repeats = 1500
        covered = 0
        for _ in range(repeats):
            result = statistics.welch(random.normal(3, 2, 10), random.normal(1, 0.5, 10))
            assert result.low is not None and result.high is not None
            covered += result.low < 2 < result.high
        assert within(covered / repeats, 0.95, repeats)

    def test_pooling_episodes_is_wrong(self, random: np.random.Generator) -> None:
        """Why seed means: taken as 500 independent episodes an arm, A/A data reject every second time.

        Pairing the episodes by test scenario is worse still: it removes the scenarios' noise from the
        yardstick and leaves the difference between agents, which is the noise that matters.
        """
        repeats, pooled, paired = 400, 0, 0
        for _ in range(repeats):
            t, c = arms_without_effect(random, seeds=5)
            pooled += stats.ttest_ind(t.ravel(), c.ravel(), equal_var=False).pvalue < 0.05
            paired += stats.ttest_rel(t.ravel(), c.ravel()).pvalue < 0.05
        assert 0.43 < pooled / repeats < 0.67
        assert paired > pooled

    def test_pooled_mean_and_slope_keep_their_level(self, random: np.random.Generator) -> None:
        repeats = 1500
        mean = slope = 0
        spread = np.array([0.5, 1.0, 2.0])[:, None]
        for _ in range(repeats):
            strata = [(t, c) for t, c in random.normal(0, 1, (3, 2, 5)) * spread[:, None]]
            mean += abs(statistics.pooled(strata).direction)
            slope += abs(statistics.effect_slope([1, 2, 3], strata).direction)
        assert within(mean / repeats, 0.05, repeats)
        assert within(slope / repeats, 0.05, repeats)

    def test_ratio_interval_covers(self, random: np.random.Generator) -> None:
        repeats, covered = 1000, 0
        for _ in range(repeats):
            result = statistics.ratio(random.normal(12, 1, 8), random.normal(10, 2, 8))
            assert result.low is not None and result.high is not None
            covered += result.low < 0.2 < result.high
        assert within(covered / repeats, 0.95, repeats)


class TestContrast:
    def test_two_groups_are_welch(self, random: np.random.Generator) -> None:
        t, c = random.normal(1, 2, 6), random.normal(0, 1, 4)
        ours, scipy = statistics.contrast([t, c], [1, -1]), statistics.welch(t, c)
        assert (ours.estimate, ours.low, ours.high, ours.p, ours.df) == pytest.approx(
            (scipy.estimate, scipy.low, scipy.high, scipy.p, scipy.df)
        )

    def test_slope_equals_least_squares(self, random: np.random.Generator) -> None:
        x = [1.0, 2.0, 3.0, 5.0]
        strata = [(random.normal(2 * k, 1, 4), random.normal(k, 1, 4)) for k in x]
        differences = [t.mean() - c.mean() for t, c in strata]
        assert statistics.effect_slope(x, strata).estimate == pytest.approx(np.polyfit(x, differences, 1)[0])
        means = [(t.mean() + c.mean()) / 2 for t, c in strata]
        assert statistics.mean_slope(x, strata).estimate == pytest.approx(np.polyfit(x, means, 1)[0])

    def test_pooled_is_the_mean_of_the_effects(self) -> None:
        result = statistics.pooled([([1.0, 2.0], [0.0, 1.0]), ([4.0, 6.0], [1.0, 3.0])])
        assert result.estimate == pytest.approx(2.0)
        assert result.n == (4, 4)

    def test_middle_level_with_weight_zero_may_be_missing(self) -> None:
        strata = [([1.0, 2.0], [0.0, 1.0]), ([], []), ([5.0, 6.0], [0.0, 1.0])]
        assert statistics.effect_slope([1, 2, 3], strata).estimate == pytest.approx(2.0)

    def test_one_seed_anywhere_gives_no_interval(self) -> None:
        result = statistics.pooled([([1.0, 2.0], [0.0, 1.0]), ([4.0], [1.0, 2.0])])
        assert result.status == "no interval: one seed"

    def test_arm_without_spread_is_kept(self) -> None:
        """Agents that never crash belong to the mean; the interval comes from the others."""
        never, seldom = [0.0, 0.0, 0.0], [0.10, 0.12, 0.08]
        result = statistics.pooled([(never, seldom), (seldom, seldom)])
        assert result.estimate == pytest.approx(-0.05)
        assert result.low is not None
        assert statistics.pooled([(never, never), (never, never)]).status == "degenerate"

    def test_nothing_to_pool(self) -> None:
        assert statistics.pooled([]).status == "missing"

    def test_slope_needs_two_levels(self) -> None:
        with pytest.raises(ValueError, match="two different levels"):
            statistics.slope_weights([2.0])


class TestPaired:
    def test_uses_the_seeds_of_both_arms(self) -> None:
        t = {0: 2.0, 1: 3.5, 2: 4.0, 9: 100.0}
        c = {0: 1.0, 1: 2.0, 2: 3.5, 7: -100.0}
        result = statistics.paired(t, c)
        expected = stats.ttest_rel([2.0, 3.5, 4.0], [1.0, 2.0, 3.5])
        assert result.n == (3, 3)
        assert result.estimate == pytest.approx(1.0)
        assert result.p == pytest.approx(expected.pvalue)

    def test_without_two_pairs(self) -> None:
        assert statistics.paired({0: 1.0, 1: 2.0}, {1: 0.0}).status == "no interval: one seed"
        assert statistics.paired({0: 1.0}, {1: 0.0}).status == "missing"


class TestMultiplicity:
    def test_equal_statsmodels(self, random: np.random.Generator) -> None:
        for p in (random.uniform(size=18) ** 3, np.array([0.04, 0.01, 0.04, 0.9]), np.array([0.5])):
            assert statistics.holm(list(p)) == pytest.approx(multipletests(p, method="holm")[1])
            assert statistics.benjamini_hochberg(list(p)) == pytest.approx(
                multipletests(p, method="fdr_bh")[1]
            )

    def test_what_has_no_p_is_skipped(self) -> None:
        assert statistics.holm([0.01, None, 0.04, 0.03]) == [
            pytest.approx(0.03), None, pytest.approx(0.06), pytest.approx(0.06),
        ]  # fmt: skip
        assert statistics.benjamini_hochberg([None, 0.02]) == [None, pytest.approx(0.02)]
        assert statistics.holm([None, None]) == [None, None]
        assert statistics.holm([]) == []

    def test_holm_keeps_the_family_wise_error(self, random: np.random.Generator) -> None:
        repeats = 1500
        found = sum(min(statistics.holm(list(random.uniform(size=18)))) < 0.05 for _ in range(repeats))
        assert within(found / repeats, 0.05, repeats)


def test_interquartile_mean_ignores_the_tails() -> None:
    assert statistics.iqm([-1000.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1000.0]) == pytest.approx(3.5)
    assert statistics.iqm([2.0]) == 2.0


class TestEquivalence:
    def test_equals_statsmodels(self, random: np.random.Generator) -> None:
        t, c = random.normal(0, 0.02, 8), random.normal(0, 0.03, 9)
        expected = ttost_ind(t, c, -0.05, 0.05, usevar="unequal")[0]
        assert statistics.equivalence(t, c, 0.05) == pytest.approx(expected)

    def test_says_no_on_the_margin_in_95_of_100(self, random: np.random.Generator) -> None:
        repeats, found = 1500, 0
        for _ in range(repeats):
            p = statistics.equivalence(random.normal(0.05, 0.01, 10), random.normal(0, 0.01, 10), margin=0.05)
            found += p is not None and p < 0.05
        assert within(found / repeats, 0.05, repeats)

    def test_is_unknown_with_one_seed(self) -> None:
        assert statistics.equivalence([0.1], [0.1], 0.05) is None


def test_ratio_is_refused_where_the_control_is_near_zero() -> None:
    result = statistics.ratio([1.0, 2.0, 3.0], [-1.0, 0.5, 1.0])
    assert result.status == "degenerate"
    assert result.estimate is None
    assert "control mean" in str(result.reason)


def test_detectable_effect_is_found_with_the_given_power(random: np.random.Generator) -> None:
    effect = statistics.detectable(random.normal(0, 1, 10), random.normal(0, 1, 10))
    assert effect is not None
    unit = statistics.detectable([0.0, 2.0] * 5, [0.0, 2.0] * 5)
    assert unit is not None
    sd = np.std([0.0, 2.0] * 5, ddof=1)
    repeats, found = 1500, 0
    for _ in range(repeats):
        found += statistics.welch(random.normal(unit, sd, 10), random.normal(0, sd, 10)).direction == 1
    assert within(found / repeats, 0.8, repeats)
