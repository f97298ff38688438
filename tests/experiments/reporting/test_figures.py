"""The figures of a report show the numbers that they are given."""

import re
from collections.abc import Callable
from itertools import combinations, product
from typing import Any
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from scipy import stats

from experiments.analysis.drivers import hazards
from experiments.reporting import arrows, figures
from experiments.reporting.card import ALL, card_figure
from experiments.study.design.traffic import TRAFFICS

SETTING = {"backend": "sumo", "task": "u-turn", "level": 1, "level_name": "3"}


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
