"""Estimates and intervals against scipy, statsmodels and truths that are known; error rates: test_instrument.py."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.meta_analysis import combine_effects
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW, ttost_ind

from experiments.analysis import statistics
from experiments.analysis.plan import TWO_BATCHES, Plan
from experiments.analysis.pooling import random_effects
from experiments.analysis.statistics import Mean, combine, interval, linear

# As measured on trained agents at worst: seeds differ with SD 1, episodes of one agent with SD 3.
SEED_SD, EPISODE_SD, EPISODES = 1.0, 3.0, 100


@pytest.fixture
def random() -> np.random.Generator:
    return np.random.default_rng(20)


def scores(values: np.ndarray) -> np.ndarray:
    """Scores of agents that were tested on a single scenario: their spread is that of the seeds."""
    return np.asarray(values, dtype=float)[:, None]


def difference(treatment: np.ndarray, control: np.ndarray, floor: float = 0.0) -> Mean:
    return linear([(treatment, 1.0), (control, -1.0)], floor)


class TestInterval:
    def test_without_scenarios_it_is_welchs(self, random: np.random.Generator) -> None:
        t, c = random.normal(1, 2, 7), random.normal(0, 1, 5)
        result = interval(difference(scores(t), scores(c)))
        other = CompareMeans(DescrStatsW(t), DescrStatsW(c))
        _, p, df = other.ttest_ind(usevar="unequal")
        low, high = other.tconfint_diff(usevar="unequal")
        assert result.estimate == pytest.approx(t.mean() - c.mean())
        assert (result.low, result.high, result.p, result.df) == pytest.approx((low, high, p, df))
        assert result.n == (7, 5)
        assert result.status == "ok"

    def test_variance_is_that_of_new_agents_on_new_scenarios(self, random: np.random.Generator) -> None:
        """The variance that is estimated is the one of repeated studies, each with its own agents and scenarios."""
        values, variances = [], []
        for _ in range(2000):
            shared, own = random.normal(0, 1, 25), random.normal(0, 1, (2, 25))
            arms = [
                random.normal(0, 0.5, (6, 1)) + shared + own[k] + random.normal(0, 1, (6, 25)) for k in (0, 1)
            ]
            mean = difference(*arms)
            values.append(mean.value)
            variances.append(mean.variance)
        assert np.mean(variances) == pytest.approx(np.var(values), rel=0.12)
        # seeds 2 x (.25 / 6 + 1 / 150), scenarios of an arm 2 / 25; what the arms share cancels
        assert np.mean(variances) == pytest.approx(2 * (0.25 / 6 + 1 / 150) + 2 / 25, rel=0.05)

    @pytest.mark.parametrize(("t", "c"), [([1.0], [0.0]), ([1.0, 2.0], [0.0]), ([1.0], [0.0, 3.0])])
    def test_one_seed_gives_none(self, t: list[float], c: list[float]) -> None:
        result = interval(difference(scores(np.array(t)), scores(np.array(c))))
        assert result.status == "no interval: one seed"
        assert (result.low, result.high, result.p, result.df) == (None, None, None, None)
        assert result.estimate == pytest.approx(np.mean(t) - np.mean(c))
        assert "two training seeds" in str(result.reason)

    def test_where_nothing_varies_it_is_degenerate(self) -> None:
        """Diverged agents all behave alike: an effect of exactly 0 with a spread of 0 is no finding."""
        same = np.full((3, 20), 13.84)
        result = interval(difference(same, same))
        assert result.status == "degenerate"
        assert result.low is None and result.p is None
        assert "nothing varies" in str(result.reason)

    def test_one_arm_without_spread_is_kept(self) -> None:
        result = interval(difference(scores(np.zeros(3)), scores(np.array([0.1, 0.2, 0.3]))))
        assert result.status == "ok"
        assert result.df == pytest.approx(2)

    def test_missing_arm(self) -> None:
        assert interval(difference(np.zeros((0, 4)), np.ones((2, 4)))).status == "missing"

    def test_refuses_values_that_are_not_numbers(self) -> None:
        with pytest.raises(ValueError, match="finite"):
            difference(np.array([[1.0], [np.nan]]), np.ones((2, 1)))

    def test_pooling_episodes_is_wrong(self, random: np.random.Generator) -> None:
        """Why seed means: taken as 500 independent episodes an arm, A/A data reject every second time.

        Pairing the episodes by test scenario is worse still: it removes the scenarios' noise from the
        yardstick and leaves the difference between agents, which is the noise that matters.
        """
        repeats, pooled, paired = 400, 0, 0
        for _ in range(repeats):
            scenario = random.normal(0, EPISODE_SD / np.sqrt(2), EPISODES)
            noise = random.normal(0, EPISODE_SD / np.sqrt(2), (2, 5, EPISODES))
            t, c = scenario + noise + random.normal(0, SEED_SD, (2, 5, 1))
            pooled += stats.ttest_ind(t.ravel(), c.ravel(), equal_var=False).pvalue < 0.05
            paired += stats.ttest_rel(t.ravel(), c.ravel()).pvalue < 0.05
        assert 0.43 < pooled / repeats < 0.67
        assert paired > pooled


class TestFewCrashes:
    def test_no_crash_at_all_has_an_interval(self) -> None:
        never = np.zeros((5, 100))
        result = interval(difference(never, never, statistics.binomial_floor([never, never])))
        assert result.estimate == 0
        assert result.high is not None and 0.002 < result.high < 0.02

    def test_it_narrows_with_more_agents(self) -> None:
        floors = [statistics.binomial_floor([np.zeros((n, 100))]) for n in (3, 10)]
        assert floors[0] > 9 * floors[1]

    def test_arms_that_crash_often_enough_speak_for_themselves(self) -> None:
        often = np.zeros((5, 100))
        often[:, ::10] = 1
        assert statistics.binomial_floor([often, 1 - often]) == 0


class TestCombine:
    def test_is_the_weighted_sum_of_independent_means(self, random: np.random.Generator) -> None:
        means = [difference(random.normal(k, 1, (4, 10)), random.normal(0, 1, (4, 10))) for k in range(3)]
        result = combine(means, [0.5, 0.25, 0.25])
        assert result.value == pytest.approx(
            sum(w * m.value for w, m in zip([0.5, 0.25, 0.25], means, strict=True))
        )
        assert result.variance == pytest.approx(
            sum(w**2 * m.variance for w, m in zip([0.5, 0.25, 0.25], means, strict=True))
        )
        assert result.n == (12, 12)

    def test_slope_equals_least_squares(self, random: np.random.Generator) -> None:
        x = [1.0, 2.0, 3.0, 5.0]
        means = [difference(random.normal(2 * k, 1, (4, 9)), random.normal(k, 1, (4, 9))) for k in x]
        slope = combine(means, statistics.slope_weights(x))
        assert slope.value == pytest.approx(np.polyfit(x, [m.value for m in means], 1)[0])

    def test_middle_level_with_weight_zero_may_be_missing(self) -> None:
        ok = difference(np.array([[1.0], [2.0]]), np.array([[0.0], [1.0]]))
        assert combine([ok, Mean(None, (), (0, 0), 0), ok], [-0.5, 0.0, 0.5]).value == 0

    def test_one_seed_anywhere_gives_no_interval(self) -> None:
        few = difference(np.array([[4.0]]), np.array([[1.0], [2.0]]))
        ok = difference(np.array([[1.0], [2.0]]), np.array([[0.0], [1.0]]))
        assert interval(combine([ok, few], [0.5, 0.5])).status == "no interval: one seed"

    def test_nothing_to_combine(self) -> None:
        assert interval(combine([], [])).status == "missing"

    def test_slope_needs_two_levels(self) -> None:
        with pytest.raises(ValueError, match="two different levels"):
            statistics.slope_weights([2.0])


class TestRandomEffects:
    def test_equals_statsmodels(self) -> None:
        y, v = np.array([0.1, -0.3, -0.2, -0.5, 0.2]), np.array([0.01, 0.02, 0.01, 0.03, 0.02])
        ours, other = (
            random_effects(list(y), list(v)),
            combine_effects(y, v, method_re="iterated", use_t=True),
        )
        assert ours is not None
        assert ours["estimate"] == pytest.approx(other.mean_effect_re)
        assert ours["tau"] == pytest.approx(other.tau2**0.5)
        se = max(other.sd_eff_w_re_hksj, other.sd_eff_w_re)
        assert ours["high"] - ours["estimate"] == pytest.approx(stats.t.ppf(0.975, 4) * se, rel=1e-6)
        assert ours["prediction"][1] - ours["estimate"] == pytest.approx(
            stats.t.ppf(0.975, 3) * np.sqrt(other.tau2 + se**2), rel=1e-6
        )

    def test_without_heterogeneity_tau_is_zero(self) -> None:
        found = random_effects([0.1, 0.1, 0.1], [0.01, 0.01, 0.01])
        assert found is not None
        assert found["tau"] == 0 and found["i2"] == 0

    def test_needs_three_effects_with_variance(self) -> None:
        assert random_effects([0.1, 0.2], [0.01, 0.01]) is None
        assert random_effects([0.1, 0.2, 0.3], [0.0, 0.01, 0.01]) is None
        few = random_effects([0.1, 0.2, 0.3], [0.01, 0.01, 0.01])
        assert few is not None and few["prediction"] is None


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

    def test_levels_reject_what_holm_rejects(self, random: np.random.Generator) -> None:
        for _ in range(200):
            p = list(random.uniform(size=7) ** 4)
            by_level = [own < level for own, level in zip(p, statistics.holm_levels(p), strict=True)]
            assert by_level == [own is not None and own < 0.05 for own in statistics.holm(p)]

    def test_at_least_so_many_is_wrong_in_five_percent(self, random: np.random.Generator) -> None:
        """Seven real effects among 18: more than seven are claimed in at most 5 % of the studies."""
        repeats, wrong, claimed = 400, 0, []
        for _ in range(repeats):
            p = np.concatenate([random.uniform(size=7) ** 8, random.uniform(size=11)])
            claimed.append(statistics.at_least(list(p), 0.05))
            wrong += claimed[-1] > 7
        assert wrong / repeats < 0.05 + 4 * np.sqrt(0.05 * 0.95 / repeats)
        assert np.mean(claimed) > 3
        assert statistics.at_least([], 0.05) == 0
        assert statistics.at_least([1e-9] * 3, 0.05) == 3


class TestLooks:
    def test_they_share_the_error_rate(self) -> None:
        assert sum(look.share for look in TWO_BATCHES.looks) == pytest.approx(1)
        assert TWO_BATCHES.looks_at(5) == [(5, 0.2)]
        assert TWO_BATCHES.looks_at(7) == [(5, 0.2)]
        assert TWO_BATCHES.looks_at(10) == [(5, 0.2), (10, 0.8)]
        assert Plan().looks_at(7) == [(None, 1.0)]


def test_interquartile_mean_ignores_the_tails() -> None:
    assert statistics.iqm([-1000.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 1000.0]) == pytest.approx(3.5)
    assert statistics.iqm([2.0]) == 2.0


class TestEquivalence:
    def test_equals_statsmodels(self, random: np.random.Generator) -> None:
        t, c = random.normal(0, 0.02, 8), random.normal(0, 0.03, 9)
        expected = ttost_ind(t, c, -0.05, 0.05, usevar="unequal")[0]
        assert statistics.equivalence(difference(scores(t), scores(c)), 0.05) == pytest.approx(expected)

    def test_is_unknown_with_one_seed(self) -> None:
        assert statistics.equivalence(difference(np.ones((1, 3)), np.ones((1, 3))), 0.05) is None


class TestRatio:
    def test_interval_covers(self, random: np.random.Generator) -> None:
        repeats, covered = 1000, 0
        for _ in range(repeats):
            result = statistics.ratio(scores(random.normal(12, 1, 8)), scores(random.normal(10, 2, 8)))
            assert result.low is not None and result.high is not None
            covered += result.low < 0.2 < result.high
        assert abs(covered / repeats - 0.95) < 4 * np.sqrt(0.05 * 0.95 / repeats)

    @pytest.mark.parametrize("control", [[-1.0, 0.5, 1.0], [-5.0, -5.1, -5.2]])
    def test_is_refused_where_the_control_is_not_above_zero(self, control: list[float]) -> None:
        result = statistics.ratio(scores(np.array([1.0, 2.0, 3.0])), scores(np.array(control)))
        assert result.status == "degenerate"
        assert result.estimate is None
        assert "control mean" in str(result.reason)


class TestPlanning:
    def test_detectable_effect_has_the_given_power(self) -> None:
        effect = statistics.detectable(se=0.5, df=18.0, alpha=0.01)
        limit = stats.t.ppf(0.995, 18)
        assert stats.nct.sf(limit, 18, effect / 0.5) == pytest.approx(0.8, abs=1e-6)

    def test_seeds_needed_are_the_first_that_detect_it(self) -> None:
        mean = Mean(0.1, ((0.01 / 5, 4.0), (0.02 / 5, 4.0), (0.0001, 99.0)), (5, 5), 5)
        seeds = statistics.seeds_needed(mean, 0.1)
        assert seeds is not None

        def detects(n: int) -> bool:
            return statistics.detectable(np.sqrt(0.03 / n + 0.0001), 2.0 * (n - 1)) <= 0.1

        assert detects(seeds) and not detects(seeds - 1)

    def test_no_number_of_seeds_makes_up_for_few_scenarios(self) -> None:
        assert (
            statistics.seeds_needed(Mean(0.1, ((0.01, 4.0), (0.01, 4.0), (0.01, 9.0)), (5, 5), 5), 0.1)
            is None
        )
