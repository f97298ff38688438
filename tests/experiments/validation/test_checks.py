"""Verdicts: against which margin, by which rule, and what they are of."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from experiments.validation import checks
from experiments.validation.checks import REFERENCE, Difference, check, margin, scorecard
from sumo_env.tasks import TASKS
from tests.experiments.validation.tables import compared, episodes

MARGIN = 1.0


def by_metric(table: pd.DataFrame, task: str = "u-turn", traffic: str = "regular"):
    found = checks.level_checks(table, "sumo", task, traffic)
    return {(item["metric"], item["ego"]): item for item in found}


@pytest.mark.parametrize(
    ("difference", "low", "high", "verdict"),
    [
        (0.5, 0.1, 0.9, "equivalent"),
        (0.5, -0.5, 1.5, "within"),  # the margin is kept, but equivalence is not shown
        (0.5, np.nan, np.nan, "within"),
        (-1.5, -2.0, -1.0, "missed"),
        (-1.01, -3.0, 1.0, "missed"),  # judged by the point estimate
    ],
)
def test_verdict(difference: float, low: float, high: float, verdict: str) -> None:
    found = Difference(difference, 0.0, difference, low, high, 10)
    assert check("metric", found, MARGIN)["verdict"] == verdict


def test_no_verdict_without_margin_or_with_too_few_scenarios() -> None:
    assert check("metric", Difference(9, 0, 9, 8, 10, 50))["verdict"] is None
    assert check("metric", Difference(9, 0, 9, 8, 10, 2), MARGIN)["verdict"] is None


def test_margins_are_those_of_the_design() -> None:
    assert set(checks.RETURN_RANGE) == set(TASKS)
    expected = {
        "traffic_speed": 0.1,
        "headway": 0.3,
        "return": 1.0,
        "crashed": 0.1,
        "crashed_ego": 0.15,
        "order": 0.0,
    }
    regular = {metric: margin(metric, "highway", "regular", 2.0) for metric in checks.MARGINS}
    assert regular == pytest.approx({**expected, "lane_changes": 0.5})  # return: of the range of 20
    assert {metric: margin(metric, "highway", "risky", 2.0) for metric in expected} == pytest.approx(expected)
    assert np.isnan(margin("lane_changes", "highway", "risky", 2.0))
    assert np.isnan(margin("length", "highway", "regular", 2.0))


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
    found = checks.level_checks(table, "sumo", "u-turn", "regular")
    by_return = next(item for item in found if item["metric"] == "order" and "return" in item["name"])
    assert by_return["verdict"] == "missed"
    assert "careful" in by_return["note"]


def test_variants_of_highway_env_stand_beside() -> None:
    table = pd.concat([compared(), episodes("v0", traffic_speed=8.0)], ignore_index=True)
    reference = by_metric(table)["traffic_speed", ""]["reference"]
    assert by_metric(table)["traffic_speed", ""]["v0"] == pytest.approx(8.0 - reference)


def test_a_task_passes_if_no_check_is_missed() -> None:
    found = scorecard(compared(crashed=True), "sumo", {"u-turn": ["3"]})
    result = checks.summary(found, ["u-turn", "highway"])
    assert result["u-turn"]["passed"] is False
    assert result["u-turn"]["counts"]["missed"] == len(result["u-turn"]["missed"]) > 0
    assert result["highway"]["passed"] is None
    same = scorecard(compared(), "sumo", {"u-turn": ["3"]})
    assert {(item["task"], item["traffic"], item["level"]) for item in same} == {("u-turn", "regular", "3")}
    assert checks.summary(same, ["u-turn"])["u-turn"]["passed"] is True


def test_recomputed_episodes_are_counted_and_the_exceptions_listed() -> None:
    truth = episodes(checks.TRUTH).assign(length=lambda t: t["length"].where(t["scenario"] != 7, 9))
    found = checks.replica_checks(pd.concat([episodes(REFERENCE), truth[truth["ego"] == "idle"]]))
    assert found["u-turn"]["episodes"] == 40
    assert found["u-turn"]["differing"] == 1
    assert found["u-turn"]["verdict"] == "missed"  # 1 in 40 is more than 1 %
    assert found["u-turn"]["exceptions"][0]["scenario"] == 7
    assert checks.replica_checks(episodes(REFERENCE)) == {}
