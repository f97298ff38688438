"""How each driver does by itself: against plain pandas, and against an interval that one can compute by hand."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis.drivers import SHOWN, drivers
from experiments.analysis.scores import at_home, with_outcomes
from experiments.study.results.loaded import Results

MADE_UP = {"levels": {"u-turn": (1, 2)}, "seeds": 4, "tests": 30, "baselines": ("slower",)}


@pytest.fixture(scope="module")
def episodes(results: Results) -> pd.DataFrame:
    return at_home(with_outcomes(results))


def test_means_are_those_of_plain_pandas(episodes: pd.DataFrame) -> None:
    found = drivers(episodes)
    assert {*found["driver"]} == {"control", "treatment", "slower"} and len(found) == 3 * 2 * 2
    names = episodes["arm"].where(episodes["kind"] == "agent", episodes["policy"])
    for row in found.to_dict("records"):
        there = episodes[(names == row["driver"]) & (episodes["level"] == row["level"])]
        there = there[there["traffic"] == row["traffic"]]
        for name in SHOWN:
            assert row[name] == pytest.approx(there[name].mean())
            ends = [row[f"{name}_low"], row[f"{name}_high"]]
            if row["driver"] == "slower":
                assert np.isnan(ends).all()
            else:
                assert ends[0] < row[name] < ends[1]


def test_agents_that_differ_in_all_scenarios_alike_have_the_interval_of_their_means(
    episodes: pd.DataFrame,
) -> None:
    """So scenarios add nothing to it."""
    alike = episodes.assign(mean_speed=20.0 + episodes["seed"].fillna(0).astype(float))
    low, high = stats.t.interval(0.95, 3, 21.5, stats.sem([20, 21, 22, 23]))
    for row in drivers(alike).query("driver in ['control', 'treatment']").to_dict("records"):
        assert (row["mean_speed_low"], row["mean_speed_high"]) == pytest.approx((low, high))


def test_nobody_who_crashes_leaves_an_interval(episodes: pd.DataFrame) -> None:
    """Of agents that never crash, as long as that of independent episodes."""
    for row in (
        drivers(episodes.assign(crashed=0.0)).query("driver in ['control', 'treatment']").to_dict("records")
    ):
        assert row["crashed"] == 0 and 0 < row["crashed_high"] < 0.05
