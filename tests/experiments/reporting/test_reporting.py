"""The tables that a report leads with, from small frames whose numbers one can compute in the head."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import combinations, product
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from scipy import stats

from experiments.analysis.drivers import hazards
from experiments.reporting import arrows, by_task, figures, page, tables
from experiments.reporting.card import ALL, card_figure
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
    ("stage", "words"), [("", "No stage"), ("a", "is the first of 3"), ("c", "are 3 of 3")]
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


def drawn(method: str, figure: Callable[..., str], shown: Any) -> list[Any]:
    """The arguments of a method of the axes, call by call, while a figure is drawn."""
    with patch.object(Axes, method) as calls:
        figure(shown, "sumo")
    return calls.call_args_list


def test_bars_over_the_traffic_levels_are_95_percent_intervals() -> None:
    means = [("control", "regular", 0.5), ("control", "risky", 0.3), ("treatment", "regular", 0.4)]
    rows = pd.DataFrame(means, columns=["arm", "traffic", "crashed"]).assign(**SETTING, policy="dqn", n=5)
    calls = drawn("errorbar", figures.against_traffic, rows.assign(**{"crashed se": 0.1}))
    bars = [bar for call in calls for bar in zip(*call.args[1:], strict=True)]
    # t with 4 degrees of freedom
    assert sorted(bars) == [pytest.approx((mean, 0.2776), abs=1e-4) for mean in (0.3, 0.4, 0.5)]


def test_the_lines_of_effects_are_intervals_at_the_level_of_the_family() -> None:
    ends = {"low": -0.2, "high": -0.1, "low_family": -0.3, "high_family": 0.0, "p_adjusted": 0.05}
    effects = pd.DataFrame([{**SETTING, "outcome": "crashed", "term": "risky", "estimate": -0.15, **ends}])
    assert drawn("plot", figures.effects_by_setting, effects)[0].args[0] == [-0.3, 0.0]


def test_bands_over_the_seconds_are_95_percent_intervals_over_agents() -> None:
    crashes = np.array([1, 2, 1, 2, 1])  # of four drives of each agent, all in the first second
    drives = pd.DataFrame({"cell": np.arange(20) // 4, "crashed": np.arange(20) % 4 < np.repeat(crashes, 4)})
    place = {**SETTING, "arm": "control", "traffic": "risky", "crash_free_time": 0.5}
    [band] = drawn(
        "fill_between", figures.crashes_by_second, drives.assign(**place).astype({"crashed": float})
    )
    expected = stats.t.interval(0.95, 4, (crashes / 4).mean(), stats.sem(crashes / 4))
    assert [limit.item() for limit in band.args[1:]] == pytest.approx(expected)


def test_learning_curves_are_of_the_lightest_level() -> None:
    cells = {
        level: {
            "key": {**SETTING, "arm": "control", "level": level},
            "learner": {"curve": {"step": [10, 20], "return": [level, 5.0], "crashed": [0.5, 0.25]}},
        }
        for level in (1, 2)
    }
    lines = [[*call.args[1]] for call in drawn("plot", figures.learning_curves, cells)]
    assert lines == [[1.0, 5.0], [0.5, 0.25]]


def test_the_hazard_is_the_share_of_the_drives_still_on_the_road_that_crashes() -> None:
    drives = pd.DataFrame(
        {"cell": "a", "crash_free_time": [0.0, 0.9, 2.0, 3.0, 3.0], "crashed": [1.0, 0.0, 1.0, 1.0, 0.0]}
    )
    other = pd.DataFrame({"cell": "b", "crash_free_time": [1.5], "crashed": [1.0]})
    found = hazards(pd.concat([drives, other]))
    # five drives in the first second, three in the second, two in the third
    assert found.loc["a"].tolist() == pytest.approx([1 / 5, 1 / 3, 1 / 2])
    assert found.loc["b"].tolist() == pytest.approx([0.0, 1.0, float("nan")], nan_ok=True)


def speeds(*rows: tuple[Any, ...]) -> pd.DataFrame:
    """task, traffic, driver, crash rate and speed; intervals of a tenth of each to either side."""
    found = pd.DataFrame(rows, columns=["task", "traffic", "driver", "crashed", "mean_speed"])
    ends = {
        f"{name}_{end}": found[name] * factor
        for name in ("crashed", "mean_speed")
        for end, factor in (("low", 0.9), ("high", 1.1))
    }
    return found.assign(**ends)


SPEEDS = speeds(
    ("u-turn", "regular", "control", 0.01, 23.0), ("u-turn", "regular", "treatment", 0.02, 12.0),
    ("u-turn", "risky", "control", 0.8, 21.0), ("u-turn", "risky", "treatment", 0.2, 11.0),
    ("highway", "regular", "control", 0.03, 29.0), ("highway", "regular", "treatment", 0.03, 29.1),
    ("highway", "risky", "control", 0.2, 29.0), ("highway", "risky", "treatment", 0.1, 29.0),
    ("highway", "risky", "slower", 0.03, 20.0),
)  # fmt: skip


def test_arrows_lead_from_control_to_treated_agents_where_they_are_apart() -> None:
    calls = drawn("annotate", arrows.crashes_against_speed, SPEEDS)
    drawn_arrows = [call.args[:3] for call in calls if "arrowprops" in call.kwargs]
    assert drawn_arrows == [
        ("", (12.0, 0.02), (23.0, 0.01)),
        ("", (11.0, 0.2), (21.0, 0.8)),
        ("", (29.0, 0.1), (29.0, 0.2)),
    ]
    [mark] = [[*call.args[:2]] for call in drawn("plot", arrows.crashes_against_speed, SPEEDS)]
    assert mark == [20.0, 0.03]


def test_no_name_of_a_task_covers_another_or_an_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    """As they are drawn, wherever the agents are; and each stands beside its own arrow."""
    monkeypatch.setattr(arrows, "to_svg", lambda figure, *_: figure)
    random = np.random.default_rng(1)
    for _ in range(5):
        rates, paces = random.uniform(0, 1, 12) ** 3, random.uniform(0, 30, 12)
        places = [*product(figures.TASKS, TRAFFICS)]
        starts = [(*place, "control", rates[k], paces[k]) for k, place in enumerate(places)]
        figure: Any = arrows.crashes_against_speed(
            speeds(*starts, *((*place, "treatment", 0.5, 15.0) for place in places)), "study"
        )
        figure.draw_without_rendering()
        for panel in figure.axes:
            boxes = [words.get_window_extent() for words in panel.texts if words.get_text()]
            assert len(boxes) == len(figures.TASKS)
            assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
            assert all(panel.bbox.y1 >= box.y1 for box in boxes)
            own = [start[3:] for start in starts if start[1] == TRAFFICS[[*figure.axes].index(panel)]]
            agents = panel.transData.transform([[pace, rate] for rate, pace in [*own, (0.5, 15.0)]])
            assert not any(box.contains(*at) for box, at in product(boxes, agents))
            for box, at in zip(boxes, agents, strict=False):
                sides = box.intervalx, box.intervaly
                near = [np.clip(place, *ends) for place, ends in zip(at, sides, strict=True)]
                assert min(np.hypot(*(near - at)), np.hypot(*(near - agents[-1]))) < 0.3 * panel.bbox.height


def test_the_report_shows_the_lightest_settings_that_have_both_arms() -> None:
    rows = [
        ("u-turn", 1, "control"),
        ("u-turn", 1, "treatment"),
        ("u-turn", 2, "control"),
        ("merge", 1, "idle"),
    ]
    found = page.lightest(pd.DataFrame(rows, columns=["task", "level", "driver"]))
    assert found["driver"].tolist() == ["control", "treatment"]


def test_the_figure_of_a_card_leads_from_regular_to_risky_traffic() -> None:
    """Of each driver of the same scenarios that has driven both; of one's own with intervals."""

    def card(scenarios: str, crashed: float, *traffics: str) -> dict[str, Any]:
        ends = {"regular": [crashed, 0.0, 0.5], "risky": [crashed + 0.25, 0.2, 0.9]}
        rows = [
            {
                "task": "u-turn",
                "level": level,
                "traffic": name,
                "crashed": ends[name],
                "mean_speed": [12, 11, 13],
            }
            for name in traffics
            for level in (ALL, "3")
        ]
        return {"set": {"u-turn": scenarios}, "rows": rows}

    both, ours = ("regular", "risky"), {"u-turn": "ours"}
    cards = {"mine": card("ours", 0.5, *both), "dqn": card("ours", 0.25, *both)}
    cards |= {"half": card("ours", 0.1, "risky"), "old": card("others", 0.2, *both)}
    calls = drawn("plot", lambda shown, _: card_figure(shown, ours, "mine") or "", cards)
    drives = [[*call.args] for call in calls if "marker" in call.kwargs]
    assert drives == [[[12, 12], [0.5, 0.75]], [[12, 12], [0.25, 0.5]]]
    [bars] = [call.args for call in calls if "marker" not in call.kwargs]
    assert bars == ([11, 13, 12, 12, 12], [0.75, 0.75, 0.75, 0.2, 0.9])
    assert card_figure({"half": cards["half"]}, ours) is None


def test_a_figure_that_stands_alone_has_every_colour_in_both_schemes() -> None:
    svg = figures.alone(arrows.crashes_against_speed(SPEEDS, "study"))
    style = svg[svg.index("<style>") : svg.index("</style>")]
    used = {*re.findall(r"var\(--([\w-]+)", svg)}
    assert {"ink", "paper", "highway", "u-turn"} <= used
    assert {name: style.count(f"--{name}:") for name in used} == dict.fromkeys(used, 2)
