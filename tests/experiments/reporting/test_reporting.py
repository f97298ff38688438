"""The tables that a report leads with, from small frames whose numbers one can compute in the head."""

from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from experiments.reporting import by_task, page, tables
from experiments.study.design.traffic import TRAFFICS


def analysis(**frames: Any) -> Any:
    """As much of an analysis as a table reads."""
    return SimpleNamespace(**frames)


def rows_by_task(*rows: tuple[Any, ...]) -> pd.DataFrame:
    """scope, simulator, traffic, outcome, control, treated, low and high of the difference."""
    columns = ["scope", "tested_on", "traffic", "outcome", "mean_against", "mean_arm", "low", "high"]
    found = pd.DataFrame(rows, columns=columns).assign(
        backend="sumo", arm="treatment", against="control", status="ok"
    )
    return found.assign(estimate=found["mean_arm"] - found["mean_against"])


TASKS = rows_by_task(
    ("u-turn", "sumo", "regular", "crashed", 0.02, 0.02, -0.01, 0.01),
    ("u-turn", "sumo", "risky", "crashed", 0.74, 0.13, -0.64, -0.57),
    ("u-turn", "sumo", "risky", "crashes_per_100_km", 632.3, 136.2, -535.1, -457.2),
    ("u-turn", "sumo", "only-parameters", "crashed", 0.017, 0.008, -0.016, -0.002),
    ("u-turn", "replica", "risky", "crashed", 0.65, 0.09, -0.60, -0.52),
    ("two-way", "sumo", "regular", "crashed", 0.2, 0.57, 0.32, 0.42),
    ("two-way", "sumo", "risky", "crashed", 0.8, 0.71, -0.13, -0.05),
    ("all tasks", "sumo", "risky", "crashed", 0.77, 0.42, -0.38, -0.31),
    ("without u-turn", "sumo", "risky", "crashed", 0.8, 0.71, -0.13, -0.05),
    ("without two-way", "sumo", "risky", "crashed", 0.74, 0.13, -0.64, -0.57),
)  # fmt: skip


def test_the_table_of_tasks_has_a_line_a_task_and_traffic() -> None:
    table = by_task.by_task(analysis(by_task=TASKS), "sumo")
    assert [*table.columns] == ["task", "traffic", "crashes [%]", "crashes per 100 km"]  # none that is empty
    marked = pd.concat([TASKS, rows_by_task(("u-turn", "sumo", "risky", "score", 0.2, 0.85, 0.5, 0.8))])
    scored = by_task.by_task(analysis(by_task=marked), "sumo")
    assert scored["score"].tolist() == ["0.20 → 0.85\n+0.65 [+0.50, +0.80]", *"–––"]
    assert table.to_numpy().tolist() == [
        ["u-turn", "risky", "74.0 → 13.0\n−61.0 [−64.0, −57.0]", "632 → 136\n−496 [−535, −457]"],
        ["u-turn", "regular", "2.0 → 2.0\n0.0 [−1.0, +1.0]", "–"],
        ["two-way", "risky", "80.0 → 71.0\n−9.0 [−13.0, −5.0]", "–"],
        ["two-way", "regular", "20.0 → 57.0\n+37.0 [+32.0, +42.0]", "–"],
    ]
    away = by_task.by_task(analysis(by_task=TASKS), "sumo", away=True)
    assert away.iloc[:, :3].to_numpy().tolist()[:2] == [
        ["u-turn", "risky drivers, no events", "1.7 → 0.8\n−0.9 [−1.6, −0.2]"],
        ["u-turn", "risky, replica", "65.0 → 9.0\n−56.0 [−60.0, −52.0]"],
    ]


def test_the_first_table_has_one_number_a_cell_and_no_empty_column() -> None:
    table = by_task.levels(analysis(by_task=TASKS), "sumo")
    crashes = ["crashes [%], control", "crashes [%], treated"]
    per_distance = ["crashes per 100 km, control", "crashes per 100 km, treated"]
    assert [*table.columns] == ["task", "traffic", *crashes, *per_distance]
    assert table.to_numpy().tolist()[:2] == [
        ["u-turn", "risky", "74.0", "13.0", "632", "136"],
        ["u-turn", "regular", "2.0", "2.0", "–", "–"],
    ]


def test_signs_are_of_the_plan_of_intervals_and_of_equal_moments() -> None:
    """A task that the plan does not ask about has none of the primary outcome."""
    primary = pd.DataFrame([("u-turn", "risky", "less")], columns=["scope", "term", "verdict"])
    found = analysis(by_task=TASKS, primary=primary.assign(backend="sumo", outcome="crashed"))
    whose = ["task", "traffic", "who is more careful", "who is more skilled"]
    moments = pd.DataFrame([("two-way", "regular", "control agents", "too few")], columns=whose)
    assert by_task.signs(found, "sumo", moments).to_numpy().tolist() == [
        ["two-way", "regular", "", "", "+", "too few"],
        ["u-turn", "risky", "−", "−", "", ""],
    ]
    assert by_task.signs(found, "sumo", pd.DataFrame()).columns[-1] == "crashes per 100 km"
    nothing = analysis(by_task=TASKS[:0], primary=found.primary[:0])
    assert by_task.signs(nothing, "sumo", pd.DataFrame()).empty


def test_each_table_is_on_a_page() -> None:
    pages = "".join(path.read_text() for path in page.TEMPLATES.glob("*.j2"))
    assert {name for name in tables.TABLES if f"table(b.{name})" not in pages} == set()


def test_a_mean_over_tasks_has_every_one_left_out_below_it() -> None:
    table = by_task.means_of_tasks(analysis(by_task=TASKS), "sumo")
    assert table.columns.tolist() == ["mean", "risky traffic [points]"]
    assert table["mean"].tolist() == ["all tasks", "without two-way", "without u-turn"]
    one_task = TASKS[TASKS["scope"].isin(["u-turn", "all tasks"])]
    assert by_task.means_of_tasks(analysis(by_task=one_task), "sumo").empty


def test_settings_in_which_gates_fail_are_named() -> None:
    rows = [("two-way", "5+2", k < 1) for k in range(3)] + [("u-turn", "3", k < 2) for k in range(3)]
    gates = pd.DataFrame([*rows, ("u-turn", "3", None)], columns=["task", "level_name", "passed"])
    expected = {"passed": 3, "of": 7, "named": {"two-way 5+2": (1, 3)}, "rest": (2, 4)}
    assert by_task.failing(gates, 0.5) == expected


def test_a_setting_that_no_rule_survives_is_named_with_its_best_driver() -> None:
    """Agents and risky traffic do not count."""
    rows = [
        ("two-way", "5+2", "", "regular", 0.9),
        ("two-way", "5+2", "", "regular", 1.0),
        ("two-way", "5+2", "control", "regular", 0.2),
        ("u-turn", "3", "", "regular", 0.0),
        ("u-turn", "3", "", "regular", 1.0),
        ("u-turn", "3", "", "risky", 1.0),
    ]
    policies = pd.DataFrame(rows, columns=["task", "level_name", "arm", "traffic", "crashed"])
    found = by_task.hopeless(analysis(policies=policies.assign(backend="sumo")), "sumo")
    assert found == {"two-way 5+2": 0.9}


def test_a_difference_is_marked_where_the_plan_decides_it_or_its_interval_does() -> None:
    """Whatever the interval says, where the plan asks."""
    verdicts = [("u-turn", "risky", "less"), ("two-way", "risky", "open")]
    primary = pd.DataFrame(verdicts, columns=["scope", "term", "verdict"]).assign(backend="sumo")
    found = analysis(by_task=TASKS, primary=primary)
    places = [("u-turn", "risky"), ("two-way", "risky"), ("u-turn", "only-parameters"), ("u-turn", "regular")]
    texts = [by_task.difference(found, "sumo", *place) for place in places]
    assert texts == ["**−61.0**", "−9.0", r"−0.9\*", "0.0"]


def test_tasks_are_on_the_side_that_the_plan_or_their_interval_says() -> None:
    """Of the primary outcome at home by the plan, whatever the interval says; of all else by the interval."""
    verdicts = [("u-turn", "risky", "less"), ("two-way", "risky", "open"), ("two-way", "regular", "more")]
    primary = pd.DataFrame(verdicts, columns=["scope", "term", "verdict"])
    found = analysis(by_task=TASKS, primary=primary.assign(backend="sumo", outcome="crashed"))
    sides = {traffic: by_task.sides(found, "sumo", "crashed", ("sumo", traffic)) for traffic in TRAFFICS}
    assert sides["risky"] == {"less": ["u-turn"], "more": [], "open": ["two-way"]}
    assert sides["regular"]["more"] == ["two-way"]
    speeds = rows_by_task(
        ("u-turn", "sumo", "risky", "mean_speed", 10.0, 9.0, -1.4, -0.6),
        ("two-way", "sumo", "risky", "mean_speed", 9.0, 9.5, 0.1, 0.9),
        ("merge", "sumo", "risky", "mean_speed", 9.0, 9.1, -0.2, 0.4),
    )
    slower = by_task.sides(
        analysis(by_task=speeds, primary=found.primary), "sumo", "mean_speed", ("sumo", "risky")
    )
    assert slower == {"less": ["u-turn"], "more": ["two-way"], "open": ["merge"]}
    away = by_task.sides(found, "sumo", "crashed", ("replica", "risky"))
    assert away == {"less": ["u-turn"], "more": [], "open": []}


@pytest.mark.parametrize(
    ("stage", "words"),
    [("", "No stage"), ("a", "is the first of 3"), ("b", "are 2 of 3"), ("c", "All 3 stages")],
)
def test_the_complete_stages_of_a_plan_are_counted(stage: str, words: str) -> None:
    shown = {"plan": {"stages": dict.fromkeys("abc")}, "notes": {"stage": stage}}
    macros: Any = page.templates(False).get_template("macros.j2").make_module(shown)
    one = {"answered": True, "name": "SUMO", "settings": 2, "beside": [], "signs": [], "missing": []}
    assert words in macros.answer(one)


SETTING = {"backend": "sumo", "task": "u-turn", "level": 1, "level_name": "3"}
NAN = float("nan")


def test_what_is_asked_of_the_learner_stands_beside_what_was_found() -> None:
    columns = ["check", "task", "arm", "agents", "estimate", "low", "high", "least", "most", "passed"]
    rows = [
        ["change", "", "control", 10, 0.0123, -0.02, 0.045, -0.05, 0.05, None],
        ["diverged", "", "", 20, 1.0, NAN, NAN, 0.0, 0.0, False],
    ]
    found = pd.DataFrame(rows, columns=columns).assign(backend="sumo")
    table = tables.learner(analysis(learner=found), "sumo").drop(columns="check")
    assert table.to_numpy().tolist() == [
        ["10 control", "0.012 [−0.020, 0.045]", "−0.050 to 0.050", "open"],
        ["20", "1", "0", "not as asked"],
    ]


def test_a_comparison_leads_from_who_is_compared_with_to_the_arm() -> None:
    row = {"outcome": "crashed", "term": "risky", "mean_against": 0.03, "mean_arm": 0.2, "status": "ok"}
    shown = tables.rates({**row, "estimate": 0.17, "low": 0.1, "high": 0.24})
    assert shown == {"crashes in risky traffic": "3.0 % → 20.0 %", "difference": "+17.0 [+10.0, +24.0]"}


def test_crashes_in_unseen_traffic_have_their_error_and_closing_speed() -> None:
    values = {"crashed": 0.1, "crashed se": 0.02, "crash_closing_speed": 8.0, "mean_speed": 20.0}
    traffics = pd.DataFrame({"traffic": ["regular", "risky", "krauss"]})
    policies = traffics.assign(**SETTING, **values, arm="control")
    table = tables.unseen(analysis(policies=policies), "sumo")
    assert table.to_numpy().tolist() == [
        ["u-turn 3", traffic, "10.0 % ± 2.0, 8.0 m/s"] for traffic in ("risky", "krauss")
    ]


def test_a_setting_is_on_a_side_by_its_adjusted_p() -> None:
    rows = [("risky", -0.1, 0.01, 0.18), ("regular", 0.2, 0.001, 0.018)]
    single = pd.DataFrame(rows, columns=["term", "estimate", "p", "p_adjusted"]).assign(**SETTING)
    nobody: dict[str, list[str]] = {traffic: [] for traffic in TRAFFICS}
    assert page.sides(single) == {"fewer": nobody, "more": {**nobody, "regular": ["u-turn 3"]}}


def test_gates_count_who_passes_and_name_what_the_others_fail() -> None:
    """An agent of which a gate could not be checked has not failed."""
    rows = [(True, ""), (None, ""), (False, "not_constant beats_constant"), (False, "beats_constant")]
    gates = pd.DataFrame(rows, columns=["passed", "failed"]).assign(**SETTING, arm="control")
    [line] = tables.gates(analysis(gates=gates), "sumo").to_dict("records")
    words = "1 constant policy, 2 not above a constant policy"
    assert line == {"setting": "u-turn 3", "control": f"2 of 4 ({words})"}


def test_the_frontier_table_has_a_row_an_arm_and_says_how_many_agents_are_compared() -> None:
    columns = ["arm", "traffic", "agents", "inside", "estimate", "low", "high"]
    found = pd.DataFrame(
        [
            ["control", "risky", 5, 4, 0.125, 0.05, 0.2],
            ["control", "regular", 5, 1, -0.03, NAN, NAN],  # one agent has no interval
            ["treatment", "risky", 5, 0, NAN, NAN, NAN],  # faster than all drivers
        ],
        columns=columns,
    ).assign(**SETTING)
    elsewhere = found.assign(backend="replica", estimate=0.9)
    table = tables.frontier(analysis(frontier=pd.concat([found, elsewhere])), "sumo")
    shown = ["risky traffic", "agents, risky", "regular traffic", "agents, regular"]
    assert table.columns.tolist() == ["setting", "arm", *shown]
    control, treatment = table.fillna("").to_numpy().tolist()
    assert control == ["u-turn 3", "control", "+12.5 [+5.0, +20.0]", "4 of 5", "−3.0", "1 of 5"]
    assert treatment == ["u-turn 3", "treatment", "–", "0 of 5", "", ""]


def test_the_report_shows_the_lightest_settings_that_have_both_arms() -> None:
    rows = [
        ("u-turn", 1, "control"),
        ("u-turn", 1, "treatment"),
        ("u-turn", 2, "control"),
        ("merge", 1, "idle"),
    ]
    found = page.lightest(pd.DataFrame(rows, columns=["task", "level", "driver"]))
    assert found["driver"].tolist() == ["control", "treatment"]
