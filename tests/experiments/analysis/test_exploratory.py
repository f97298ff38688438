"""What is looked at beside the plan: it finds what was planted, and touches nothing that the plan decides."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.analysis import analyse
from experiments.analysis.exploratory import ALL_TASKS, CRASH_TYPES, _tail, kind_of_crash, transfer
from experiments.analysis.tables import with_outcomes
from experiments.study.arms import EXTRA_ARMS
from experiments.study.results import load
from tests.experiments import synthetic

LEVELS = {"highway": (1,), "u-turn": (1,)}
MAIN = (
    "headlines",
    "claims",
    "ate",
    "pooled",
    "failures",
    "slopes",
    "sensitivity",
    "placebo",
    "gates",
    "policies",
)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    home = tmp_path_factory.mktemp("further")
    synthetic.write(
        home, LEVELS, seeds=6, tests=60, effect=-0.4, spread=0.01, further=tuple(EXTRA_ARMS),
        test_on=("replica", "highway-env"), marks=True,
    )  # fmt: skip
    return load(home)


@pytest.fixture(scope="module")
def analysis(results):
    return analyse(results)


def one(records, **wanted):
    (found,) = [r for r in records if all(r[key] == value for key, value in wanted.items())]
    return found


def test_nothing_that_the_plan_decides_changes(analysis, tmp_path):
    synthetic.write(tmp_path, LEVELS, seeds=6, tests=60, effect=-0.4, spread=0.01)
    alone = analyse(load(tmp_path))
    assert {part: analysis[part] for part in MAIN} == {part: alone[part] for part in MAIN}
    assert analysis["left_out"] == [] and analysis["incomplete"] == []


def test_the_positive_control_is_found(analysis):
    (control,) = analysis["exploratory"]["positive_control"]
    assert control["found"]
    assert control["estimate"] == pytest.approx(synthetic.PENALTY, abs=0.06)


def test_doses_are_ordered(analysis):
    records = analysis["exploratory"]["doses"]
    assert [(r["task"], r["level_name"]) for r in records] == [("highway", "50"), ("u-turn", "3")]
    for record in records:
        assert record["doses"] == record["tests"] == [0.0, 0.25, 0.5, 0.75, 1.0]
        assert np.array(record["rates"]).shape == (5, 5)
        assert record["slope"]["high"] < 0
        assert record["slope"]["estimate"] == pytest.approx(-0.4, abs=0.12)


def test_dense_traffic_is_compared_with_both_arms(analysis):
    found = analysis["exploratory"]["arms"]
    chosen = {"arm": "dense", "scope": ALL_TASKS, "outcome": "crashed", "term": "risky"}
    assert abs(one(found, **chosen, against="control")["estimate"]) < 0.1
    assert one(found, **chosen, against="treatment")["low"] > 0


def test_agents_are_compared_on_other_simulators(analysis):
    found = analysis["exploratory"]["transfer"]
    for simulator in ("replica", "highway-env"):
        record = one(found, tested_on=simulator, scope=ALL_TASKS, term="risky")
        assert record["high"] < 0 and record["seeds"] == [12, 12]
        assert record["at_home"]["tested_on"] == "sumo" and record["at_home"]["seeds"] == [12, 12]
    chosen = {"scope": ALL_TASKS, "term": "risky"}
    replica, highway_env = (
        one(found, **chosen, tested_on=name)["at_home"] for name in ("replica", "highway-env")
    )
    over_all_scenarios = one(analysis["pooled"], primary=True)["estimate"]
    assert replica["estimate"] == pytest.approx(over_all_scenarios)
    assert highway_env["estimate"] != pytest.approx(over_all_scenarios)  # the first 20 alone


def test_an_agent_that_is_lost_at_home_is_not_compared_elsewhere(results):
    keys = {name: cell["key"] for name, cell in results.cells.items()}
    lost = next(n for n, key in keys.items() if (key["kind"], key["arm"]) == ("agent", "treatment"))
    cells = {name: cell for name, cell in results.cells.items() if name != lost}
    episodes = with_outcomes(results.episodes, results.cells)
    record = one(
        transfer(episodes[episodes["cell"] != lost], cells),
        tested_on="replica",
        scope=ALL_TASKS,
        term="risky",
    )
    assert record["seeds"] == record["at_home"]["seeds"] == [11, 12]


def test_the_effect_grows_with_the_budget(analysis):
    rows = [r for r in analysis["exploratory"]["budget"] if r["term"] == "risky"]
    assert [r["share"] for r in rows] == pytest.approx([1 / 3, 2 / 3, 1.0])
    sizes = [r["estimate"] for r in rows]
    assert sizes == sorted(sizes, reverse=True)


def test_kinds_of_crashes_add_up(analysis):
    rows = [
        r for r in analysis["exploratory"]["crash_types"] if (r["scope"], r["term"]) == (ALL_TASKS, "risky")
    ]
    assert [r["kind"] for r in rows] == list(CRASH_TYPES)
    primary = one(analysis["pooled"], primary=True)
    assert sum(r["estimate"] for r in rows) == pytest.approx(primary["estimate"])


@pytest.mark.parametrize(
    ("kind", "x", "y", "heading", "named"),
    [
        ("rear-end", 5.0, 0.2, 0.0, "rear-end, striking"),
        ("rear-end", -5.0, 0.2, 0.0, "rear-end, struck"),
        ("rear-end", 4.9, 1.0, -0.1, "cut-in"),  # ahead on the right, coming to the left
        ("side", 1.0, -2.0, 0.2, "cut-in"),
        ("side", 1.0, -2.0, -0.2, "side"),  # moving away
        ("frontal", 5.0, 0.0, 3.1, "frontal"),
        ("junction", 3.5, 0.0, 1.5, "junction, striking"),
        ("junction", 0.5, 3.4, 1.5, "junction, struck"),
    ],
)
def test_a_crash_is_named(kind, x, y, heading, named):
    row = {"crash_type": kind, "crashed": 1.0}
    row |= {"crash_relative_x": x, "crash_relative_y": y, "crash_relative_heading": heading}
    none = {**dict.fromkeys(row), "crashed": 0.0}
    assert kind_of_crash(pd.DataFrame([row, none])).tolist() == [named, ""]


def test_the_worst_tenth(results):
    scores = np.array([[5.0, 1.0, *[9.0] * 18], [2.0] * 20])
    assert _tail(scores).tolist() == [[3.0], [2.0]]


def test_cells_that_fit_no_comparison_are_left_out_and_named(tmp_path):
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, further=("dense",), updates=200)
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, updates=400)
    found = analyse(load(tmp_path))
    assert found["exploratory"]["arms"] == []
    reasons = {entry["cell"]: entry["reason"] for entry in found["left_out"]}
    assert sum("no agents of both arms" in reason for reason in reasons.values()) == 2
