"""Paired comparison: what is a pair, what is the unit, what an interval covers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.validation import checks as compare
from experiments.validation.episodes import BIN, BINS, HEADWAYS


def row(engine: str, scenario: int, ego: str = "idle", **values: Any) -> dict[str, Any]:
    place = {"task": "highway", "level": 1, "traffic": "regular", "ego": ego, "scenario": scenario}
    return {"engine": engine, **place, **values}


def both(values: dict[str, list[tuple[float, float]]], measure: str = "return") -> pd.DataFrame:
    rows = []
    for ego, cases in values.items():
        for scenario, (first, second) in enumerate(cases):
            for engine, value in (("a", first), ("b", second)):
                rows.append(row(engine, scenario, ego, **{measure: value}))
    return compare.pairs(pd.DataFrame(rows), "a", "b")


def test_the_scenario_is_the_unit() -> None:
    once = compare.mean_difference(both({"idle": [(1, 0), (3, 0), (2, 0)]}), "return")
    twice = compare.mean_difference(
        both({ego: [(1, 0), (3, 0), (2, 0)] for ego in ("idle", "faster")}), "return"
    )
    assert once.difference == twice.difference == 2
    assert once.n == twice.n == 3
    assert (once.low, once.high) == pytest.approx((twice.low, twice.high))


def test_pairs_without_a_value_are_left_out() -> None:
    found = compare.mean_difference(both({"idle": [(1, 0), (np.nan, 0), (5, np.nan)]}), "return")
    assert (found.difference, found.n) == (1, 1) and np.isnan(found.low)


def test_interval_covers_the_truth_nine_times_in_ten() -> None:
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(1000):
        low, high = compare.interval(rng.normal(1.0, 2.0, size=8))
        covered += low <= 1.0 <= high
    assert 860 < covered < 940


def histogram(bin_: int, count: int = 3) -> dict[str, int]:
    return {name: count * (number == bin_) for number, name in enumerate(HEADWAYS)}


def test_wasserstein_distance_of_shifted_headways() -> None:
    rows = [row(engine, k, **histogram(bin_)) for engine, bin_ in (("a", 4), ("b", 10)) for k in range(4)]
    found = compare.headway_distance(compare.pairs(pd.DataFrame(rows), "a", "b"))
    assert found.difference == pytest.approx(6 * BIN)
    assert (found.low, found.high) == pytest.approx((6 * BIN, 6 * BIN))
    assert np.isnan(compare.wasserstein(np.zeros(BINS), np.ones(BINS)))


def test_order_counts_decided_pairs_only() -> None:
    values = {
        "idle": [(1.0, 1.0), (1.1, 1.1), (0.9, 0.9)],
        "faster": [(0.0, 3.0), (0.1, 3.2), (0.2, 3.1)],  # better in the second simulator, worse in the first
        "slower": [(1.0, 0.5), (1.0, 1.5), (1.0, 1.0)],  # undecided against idle
    }
    turned, decided = compare.reversed_pairs(both(values), "return")
    assert decided == 2
    assert sorted(turned) == ["faster / idle", "faster / slower"]


def test_an_episode_is_the_same_if_it_ends_alike() -> None:
    values = {"outcome": "time", "length": 20, "return": 12.0}
    rows = [row("a", k, **values) for k in range(4)]
    rows += [row("b", 0, **values), row("b", 1, **{**values, "outcome": "crashed"})]
    rows += [row("b", 2, **{**values, "return": 12.1}), row("b", 3, **{**values, "return": 12.0001})]
    found = compare.differing(compare.pairs(pd.DataFrame(rows), "a", "b"))
    assert found["scenario"].tolist() == [1, 2]
