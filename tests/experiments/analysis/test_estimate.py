"""Estimates and intervals against scipy, statsmodels and truths that are known; error rates: test_instrument.py."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.spatial import ConvexHull
from statsmodels.stats.multitest import multipletests
from statsmodels.stats.weightstats import CompareMeans, DescrStatsW, ttost_ind

from experiments.analysis import estimate
from experiments.analysis.drivers import lower_hull, to_frontier
from experiments.analysis.estimate import Mean, combine, interval, linear


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
            values.append(mean.estimate)
            variances.append(mean.variance)
        assert np.mean(variances) == pytest.approx(np.var(values), rel=0.12)
        # seeds 2 x (.25 / 6 + 1 / 150), scenarios of an arm 2 / 25; what the arms share cancels
        assert np.mean(variances) == pytest.approx(2 * (0.25 / 6 + 1 / 150) + 2 / 25, rel=0.05)

    @pytest.mark.parametrize(("t", "c"), [([1.0], [0.0]), ([1.0, 2.0], [0.0]), ([1.0], [0.0, 3.0])])
    def test_one_seed_gives_none(self, t: list[float], c: list[float]) -> None:
        result = interval(difference(scores(np.array(t)), scores(np.array(c))))
        assert result.status == "one seed"
        assert np.isnan([result.low, result.high, result.p, result.df]).all()
        assert result.estimate == pytest.approx(np.mean(t) - np.mean(c))

    def test_one_arm_without_spread_is_kept(self) -> None:
        result = interval(difference(scores(np.zeros(3)), scores(np.array([0.1, 0.2, 0.3]))))
        assert result.status == "ok"
        assert result.df == pytest.approx(2)

    def test_refuses_values_that_are_not_numbers(self) -> None:
        with pytest.raises(ValueError, match="finite"):
            difference(np.array([[1.0], [np.nan]]), np.ones((2, 1)))


class TestFewCrashes:
    @pytest.mark.parametrize("same", [np.zeros((5, 100)), np.ones((5, 100))])
    def test_no_crash_at_all_has_an_interval_and_so_has_a_crash_always(self, same: np.ndarray) -> None:
        result = interval(difference(same, same, estimate.binomial_floor([same, same])))
        assert result.estimate == 0
        assert 0.002 < result.high < 0.02

    def test_arms_that_crash_often_enough_speak_for_themselves(self) -> None:
        often = np.zeros((5, 100))
        often[:, ::10] = 1
        assert estimate.binomial_floor([often, 1 - often]) == 0


def combined(means: list[Mean], weights: list[float]) -> Any:
    """The one sum of means."""
    frame = pd.DataFrame(means).assign(group=0)
    [row] = combine(frame, ["group"], pd.Series(weights)).itertuples()
    return row


class TestCombine:
    def test_slope_equals_least_squares(self, random: np.random.Generator) -> None:
        x = [1.0, 2.0, 3.0, 5.0]
        means = [difference(random.normal(2 * k, 1, (4, 9)), random.normal(k, 1, (4, 9))) for k in x]
        weights = estimate.slope_weights(pd.DataFrame({"level": x, "task": "highway"}), ["task"])
        expected = np.polyfit(x, [mean.estimate for mean in means], 1)[0]
        assert combined(means, list(weights)).estimate == pytest.approx(expected)

    def test_one_seed_anywhere_gives_no_interval(self) -> None:
        few = difference(np.array([[4.0]]), np.array([[1.0], [2.0]]))
        ok = difference(np.array([[1.0], [2.0]]), np.array([[0.0], [1.0]]))
        assert combined([ok, few], [0.5, 0.5]).status == "one seed"


class TestMultiplicity:
    @pytest.mark.parametrize(("own", "theirs"), [("holm", "holm"), ("bh", "fdr_bh")])
    def test_equals_statsmodels(self, own: str, theirs: str, random: np.random.Generator) -> None:
        p = random.uniform(0, 0.2, 40).round(2)  # with ties
        assert estimate.adjusted(p, own) == pytest.approx(multipletests(p, method=theirs)[1])

    def test_what_has_no_p_is_skipped(self) -> None:
        found = estimate.adjusted([0.01, np.nan, 0.04, 0.03])
        assert found == pytest.approx([0.03, np.nan, 0.06, 0.06], nan_ok=True)
        assert estimate.adjusted([np.nan, 0.02], "bh") == pytest.approx([np.nan, 0.02], nan_ok=True)
        assert np.isnan(estimate.adjusted([np.nan, np.nan])).all()
        assert len(estimate.adjusted([])) == 0


class TestEquivalence:
    def test_equals_statsmodels(self, random: np.random.Generator) -> None:
        t, c = random.normal(0, 0.02, 8), random.normal(0, 0.03, 9)
        expected = ttost_ind(t, c, -0.05, 0.05, usevar="unequal")[0]
        found = estimate.equivalence(interval(difference(scores(t), scores(c))), 0.05)
        assert found == pytest.approx(expected)


@pytest.mark.parametrize("seed", range(20))
def test_the_hull_is_the_lower_part_of_scipys(seed: int) -> None:
    points = np.random.default_rng(seed).random((9, 2))
    found = lower_hull(pd.DataFrame(points, columns=["progress", "crashed"]))
    ends = points[:, 0].min(), points[:, 0].max()
    line = np.interp(points[:, 0], found["progress"], found["crashed"])
    assert (found["progress"].iloc[0], found["progress"].iloc[-1]) == ends
    assert (points[:, 1] >= line - 1e-12).all()
    corners = {tuple(points[k]) for k in ConvexHull(points).vertices}
    assert set(found.itertuples(index=False, name=None)) <= corners


def episodes(policy: str, kind: str, arm: str | None, progress: float, crashes: list[bool]) -> pd.DataFrame:
    place = {"backend": "sumo", "task": "u-turn", "level": 1, "level_name": "3", "tested_on": "sumo"}
    own = {"cell": policy, "policy": policy, "kind": kind, "arm": arm, "traffic": "risky", "seconds": 10.0}
    return pd.DataFrame({**place, **own, "progress": progress, "crashed": np.array(crashes, float)})


def test_the_distance_is_the_crash_rate_above_the_line_between_two_drivers() -> None:
    rules = [
        episodes("slower", "baseline", None, 4.0, [False] * 4),
        episodes("careful-4", "baseline", None, 8.0, [True] * 4),
        episodes("idle", "baseline", None, 6.0, [True] * 4),  # above the line between the others
        *(episodes(name, "baseline", None, 6.0, [False] * 4) for name in ("planner", "idm")),  # no part of it
    ]
    agents = [
        episodes("a", "agent", "control", 6.0, [True, True, True, False]),  # .75 where the line is at .5
        episodes("b", "agent", "control", 5.0, [True, False, False, False]),  # .25 at .25
        episodes("c", "agent", "control", 9.0, [True] * 4),  # faster than all drivers
    ]
    [found] = to_frontier(pd.concat(rules + agents)).to_dict("records")
    half = stats.t.ppf(0.975, 1) * np.std([0.25, 0.0], ddof=1) / np.sqrt(2)
    assert (found["arm"], found["traffic"], found["agents"], found["inside"]) == ("control", "risky", 3, 2)
    assert found["estimate"] == pytest.approx(0.125)
    assert (found["low"], found["high"]) == pytest.approx((0.125 - half, 0.125 + half))


def test_without_drivers_there_is_no_distance() -> None:
    assert to_frontier(episodes("a", "agent", "control", 6.0, [True, False])).empty
