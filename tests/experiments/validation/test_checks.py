"""Verdicts: against which margin, by which rule, and what they are of."""

from collections import Counter
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.study.compute.evaluate import limits
from experiments.validation import checks
from experiments.validation.checks import REFERENCE, scorecard
from experiments.validation.episodes import BIN, BINS, HEADWAYS, egos
from tests.experiments.validation.tables import compared, episodes

MARGIN = 1.0


def by_metric(table: pd.DataFrame):
    found = checks.level_checks(table, "u-turn", "regular")
    return {(item["metric"], item["ego"]): item for item in found}


@pytest.mark.parametrize(
    ("difference", "low", "high", "verdict"),
    [
        (0.5, 0.1, 0.9, "equivalent"),
        (0.5, -0.5, 1.5, "within"),  # the margin is kept, but equivalence is not shown
        (0.5, np.nan, np.nan, "within"),
        (-1.5, -2.0, -1.0, "not decided"),  # a part of the interval is within the margin
        (-1.5, -2.0, -1.1, "missed"),
        (1.5, 1.1, 2.0, "missed"),
        (1.5, np.nan, np.nan, "not decided"),
    ],
)
def test_verdicts(difference: float, low: float, high: float, verdict: str) -> None:
    found = {"difference": difference, "low": low, "high": high, "n": 10}
    assert checks.verdict(found, MARGIN) == verdict


def test_noise_of_few_scenarios_misses_nothing() -> None:
    """Two simulators of the same law: with 20 scenarios about every tenth estimate is outside, hardly an interval."""
    verdicts: Counter[str] = Counter()
    for seed in range(10):
        noise = np.random.default_rng(seed)
        other = episodes("sumo", n=20, crashed=lambda *_, noise=noise: bool(noise.random() < 0.4))
        truth = episodes(REFERENCE, n=20, crashed=lambda *_, noise=noise: bool(noise.random() < 0.4))
        table = pd.concat([other, truth], ignore_index=True)
        found = checks.level_checks(table, "u-turn", "regular")
        verdicts.update(
            item["verdict"] for item in found if item["metric"] in ("crashed", "crashed_ego", "order")
        )
    assert verdicts["not decided"] > 10 > 2 >= verdicts["missed"]


def test_a_simulator_that_does_the_same_is_equivalent_everywhere() -> None:
    found = [item for item in by_metric(compared()).values() if item["verdict"]]
    assert {item["verdict"] for item in found if item["metric"] != "order"} == {"equivalent"}
    assert {item["metric"] for item in found} == set(checks.MARGINS) - {"lane_changes"}


def test_one_ego_may_crash_more_often_than_all_of_them() -> None:
    table = compared(crashed=lambda ego, scenario: ego == "idle" and scenario % 2 == 0)
    found = by_metric(table)
    assert found["crashed_ego", "idle"]["verdict"] == "missed"
    assert found["same_outcome", ""]["verdict"] is None  # shown without a target


def test_a_reversed_order_of_egos_is_named() -> None:
    table = compared()
    for engine, sign in ((REFERENCE, 1.0), ("sumo", -1.0)):
        chosen = (table["engine"] == engine) & (table["ego"] == "careful")
        table.loc[chosen, "return"] += 3.0 * sign
    found = checks.level_checks(table, "u-turn", "regular")
    by_return = next(item for item in found if item["metric"] == "order" and "return" in item["name"])
    assert by_return["verdict"] == "missed"
    assert "careful" in by_return["note"]


def test_variants_of_highway_env_stand_beside() -> None:
    table = pd.concat([compared(), episodes("v0", traffic_speed=8.0)], ignore_index=True)
    reference = by_metric(table)["traffic_speed", ""]["reference"]
    assert by_metric(table)["traffic_speed", ""]["v0"] == pytest.approx(8.0 - reference)


def test_a_task_passes_if_no_check_is_missed() -> None:
    found = scorecard(compared(crashed=True))
    result = checks.summary(found, ["u-turn", "highway"])
    assert result["u-turn"]["passed"] is False
    own = result["u-turn"]
    assert own["counts"]["missed"] + own["counts"]["not decided"] == len(own["outside"]) > 0
    assert own["counts"]["missed"] == sum(item["verdict"] == "missed" for item in own["outside"]) > 0
    assert own["orders"] == 2 and own["agents"] == []
    assert result["highway"]["passed"] is None
    same = scorecard(compared())
    assert {(item["task"], item["traffic"], item["level"]) for item in same} == {("u-turn", "regular", "3")}
    assert checks.summary(same, ["u-turn"])["u-turn"]["passed"] is True
    safe = scorecard(pd.concat([episodes(name, crashed=False) for name in ("sumo", REFERENCE)]))
    undecided = sum(item["metric"] == "order" and item["reference"] == 0 for item in safe)
    # the crash rates of the mean over egos and of each ego, and orders of which highway-env decides none
    zeros = checks.summary(safe, ["u-turn"])["u-turn"]["zeros"]
    assert zeros == 1 + len(egos("u-turn")) + undecided and undecided >= 1


def test_trained_agents_are_compared_and_not_judged() -> None:
    """Each by itself, and in no mean over egos."""
    agents = [episodes(name, crashed=name == "sumo").assign(ego="control") for name in ("sumo", REFERENCE)]
    found = by_metric(pd.concat([compared(), *agents]))
    agent = found.pop(("crashed_agent", "control"))
    assert (agent["difference"], agent["verdict"]) == (1.0, None)
    assert found.keys() == by_metric(compared()).keys()
    assert found["crashed", ""]["sumo"] == by_metric(compared())["crashed", ""]["sumo"]
    (row,) = checks.summary([{"task": "u-turn", "traffic": "", "level": "", **agent}], ["u-turn"])["u-turn"][
        "agents"
    ]
    assert (row["ego"], row["sumo"], row["reference"]) == ("control", 1.0, 0.0)


def test_recomputed_episodes_are_counted_and_the_exceptions_listed() -> None:
    truth = episodes(checks.TRUTH).assign(length=lambda t: t["length"].where(t["scenario"] != 7, 9))
    found = checks.replica_checks(pd.concat([episodes(REFERENCE), truth[truth["ego"] == "idle"]]))
    assert found["u-turn"]["episodes"] == 40
    assert found["u-turn"]["differing"] == 1
    assert found["u-turn"]["verdict"] == "missed"  # 1 in 40 is more than 1 %
    assert found["u-turn"]["exceptions"][0]["scenario"] == 7
    assert checks.replica_checks(episodes(REFERENCE)) == {}


# -- paired comparison: what is a pair, what is the unit, what an interval covers ---------------------------


def row(engine: str, scenario: int, ego: str = "idle", **values: Any) -> dict[str, Any]:
    place = {"task": "highway", "level": 1, "traffic": "regular", "ego": ego, "scenario": scenario}
    return {"engine": engine, **place, **values}


def both(values: dict[str, list[tuple[float, float]]], measure: str = "return") -> pd.DataFrame:
    rows = []
    for ego, cases in values.items():
        for scenario, (first, second) in enumerate(cases):
            for engine, value in (("a", first), ("b", second)):
                rows.append(row(engine, scenario, ego, **{measure: value}))
    return checks.pairs(pd.DataFrame(rows), "a", "b")


def test_the_scenario_is_the_unit() -> None:
    once = checks.mean_difference(both({"idle": [(1, 0), (3, 0), (2, 0)]}), "return")
    twice = checks.mean_difference(
        both({ego: [(1, 0), (3, 0), (2, 0)] for ego in ("idle", "faster")}), "return"
    )
    assert once == pytest.approx(twice)
    assert (once["difference"], once["n"]) == (2, 3)


def test_the_interval_is_students() -> None:
    values = pd.Series(np.random.default_rng(0).normal(1.0, 2.0, size=8))
    found = limits(values, is_share=False, confidence=0.9)
    assert found[1:] == pytest.approx(stats.ttest_1samp(values, 0.0).confidence_interval(0.9))
    assert np.isnan(limits(values[:1], is_share=False)[1:]).all()


def histogram(bin_: int) -> dict[str, Any]:
    return {name: 3 * (number == bin_) for number, name in enumerate(HEADWAYS)}


def test_a_distance_and_its_interval_are_of_a_mean_where_one_side_lies_above_the_other() -> None:
    bins = np.random.default_rng(0).integers(4, 9, 200)
    rows = [row("a", k, **histogram(bin_)) for k, bin_ in enumerate(bins)]
    rows += [row("b", k, **histogram(20)) for k in range(200)]
    found = checks.headway_distance(checks.pairs(pd.DataFrame(rows), "a", "b"))
    _, low, high = limits(pd.Series(BIN * (20.0 - bins)), is_share=False, confidence=0.9)
    assert found["difference"] == pytest.approx((low + high) / 2)
    assert found["high"] - found["low"] == pytest.approx(high - low, rel=0.1)
    assert np.isnan(checks.wasserstein(np.zeros(BINS), np.ones(BINS)))


def test_an_episode_is_the_same_if_it_ends_alike() -> None:
    values: dict[str, Any] = {"outcome": "time", "length": 20, "return": 12.0}
    rows = [row("a", k, **values) for k in range(4)]
    rows += [row("b", 0, **values), row("b", 1, **{**values, "outcome": "crashed"})]
    rows += [row("b", 2, **{**values, "return": 12.1}), row("b", 3, **{**values, "return": 12.0001})]
    found = checks.differing(checks.pairs(pd.DataFrame(rows), "a", "b"))
    assert found["scenario"].tolist() == [1, 2]


def test_order_counts_decided_pairs_only() -> None:
    values = {
        "idle": [(1.0, 1.0), (1.1, 1.1), (0.9, 0.9)],
        "faster": [(0.0, 3.0), (0.1, 3.2), (0.2, 3.1)],  # better in the second simulator, worse in the first
        "slower": [(1.0, 0.5), (1.0, 1.5), (1.0, 1.0)],  # undecided against idle
    }
    turned, decided = checks.reversed_pairs(both(values), "return")
    assert decided == 2
    # The means of the first simulator are opposite in both pairs; it decides these pairs, too.
    assert turned == {"faster / idle": True, "faster / slower": True}
    values["slower"] = [(1.0, 0.5), (1.0, 1.5), (-1.6, 1.0)]  # now its interval holds 0
    assert checks.reversed_pairs(both(values), "return") == (
        {"faster / idle": True, "faster / slower": False},
        2,
    )


def test_pairs_without_a_value_are_left_out() -> None:
    found = checks.mean_difference(both({"idle": [(1, 0), (np.nan, 0), (5, np.nan)]}), "return")
    assert (found["difference"], found["n"]) == (1, 1) and np.isnan(found["low"])


@pytest.mark.parametrize(("n", "margin"), [(50, np.nan), (2, MARGIN)])
def test_no_verdict_without_margin_or_with_too_few_scenarios(n: int, margin: float) -> None:
    assert checks.verdict({"difference": 9.0, "low": 8.0, "high": 10.0, "n": n}, margin) is None
