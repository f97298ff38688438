"""The pages that quote results: filled from their templates, and their numbers computed a second time.

The functions that fill pages (docs/pages.py) read the stored analysis. Here the same numbers come from the stored
episodes, with names of cells in place of their records and loops in place of frames. No test holds a sentence.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from statistics import fmean

import pandas as pd
import pyarrow.parquet as pq
import pytest
from statsmodels.stats.proportion import proportion_confint

from docs import pages
from docs.pages import ROOT, effect, filled, page_of, rate, templates
from experiments.analysis.gates import CROSSINGS
from sumo_env.tasks import TASKS
from tests.pages import PAGES, TEXTS, section, table

RESULTS = ROOT / "results"
BOTH = ("control", "treatment")
STUDIES = sorted(path.parent.name for path in RESULTS.glob("*/PUBLISHED.md"))
each_template = pytest.mark.parametrize("template", templates(), ids=lambda path: path.name)


# -- pages -------------------------------------------------------------------------------------------------------------


@each_template
def test_a_page_is_what_its_template_makes_of_the_results(template: Path) -> None:
    page = page_of(template)
    assert TEXTS[page] == filled(template), f"make pages writes {page.relative_to(ROOT)} again"


def test_each_page_that_says_so_has_a_template() -> None:
    made = [page for page in PAGES if TEXTS[page].startswith("<!-- Filled by")]
    assert sorted(made) == sorted(map(page_of, templates())) != []


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_all_lines_of_a_table_have_as_many_cells(page: Path) -> None:
    for rows in re.findall(r"(?:^\|.*\n)+", TEXTS[page], re.MULTILINE):
        assert len({line.count("|") for line in rows.splitlines()}) == 1, rows


def test_tables_follow_the_settings_of_a_folder() -> None:
    names = [f"{task} {level}" for task, definition in TASKS.items() for level in definition.levels]
    assert pages.settings("standard") == names and set(pages.settings("second")) < set(names)
    assert all(effect("standard", "crashed", "regular", name).estimate for name in names)


def test_an_effect_that_is_not_stored_is_an_error() -> None:
    with pytest.raises(LookupError, match="no rows of 'u-turn 4'"):
        effect("second", "crashed", "risky", "u-turn 4")
    with pytest.raises(LookupError, match="results/second has 0 effects"):
        effect("second", "crashed", "risky", arm="dose25")
    with pytest.raises(LookupError, match="expected one"):
        pages.row("second", "claims", name="return rises", quantity="nothing")


# -- the same numbers from the episodes --------------------------------------------------------------------------------

NAME = re.compile(
    rf"(sumo|replica)-(?P<task>{'|'.join(TASKS)})-(?P<level>.+?)"
    r"-(?P<arm>control|treatment|mixed-seen|mixed|drawn|dense|penalty|dose\d\d)-s\d+(?P<place>-on-replica)?-[0-9a-f]{12}"
)
Agents = dict[tuple[str, str], dict[str, pd.DataFrame]]  # setting ("u-turn 3"), arm -> agent -> episodes


@cache
def agents(folder: str) -> Agents:
    """The test episodes of each agent, from the names of the cells alone; "-on-replica" is part of an arm's name."""
    columns = ["cell", "traffic", "scenario", "crashed", "mean_speed", "distance", "crash_time"]
    found: Agents = {}
    for name, rows in pd.read_parquet(RESULTS / folder / "episodes.parquet", columns=columns).groupby("cell"):
        parts = NAME.fullmatch(str(name))
        if parts:  # else a driver of fixed rules, or a further test of an agent
            arm = parts["arm"] + (parts["place"] or "")
            found.setdefault((f"{parts['task']} {parts['level']}", arm), {})[str(name)] = rows
    return found


def drives(folder: str, setting: str, arm: str, traffic: str) -> list[pd.DataFrame]:
    """The test episodes in a traffic, agent by agent."""
    return [rows[rows["traffic"] == traffic] for rows in agents(folder)[setting, arm].values()]


def mean(folder: str, column: str, arm: str, traffic: str, wanted: Sequence[str] = ()) -> float:
    """Over agents, then over the settings of a task, then over tasks."""
    by_task: dict[str, list[float]] = {}
    for setting, there in agents(folder):
        if there == arm and (not wanted or setting in wanted):
            own = [rows[column].mean() for rows in drives(folder, setting, arm, traffic)]
            by_task.setdefault(setting.split()[0], []).append(fmean(own))
    return fmean(fmean(values) for values in by_task.values())


LIGHTEST = [f"{task} {next(iter(definition.levels))}" for task, definition in TASKS.items()]
WITHOUT_ROAD = [f"{task} {level}" for task in TASKS if task != "two-way" for level in TASKS[task].levels]


@pytest.mark.parametrize(
    ("folder", "arm", "scope", "wanted"),
    [
        ("second", "treatment", "all tasks", ()),
        ("second", "mixed", "all tasks", ()),
        ("second", "mixed", "lightest", LIGHTEST),
        ("second", "treatment", "without two-way", WITHOUT_ROAD),
        ("second", "treatment", "intersection 30", ["intersection 30"]),
        ("second", "treatment", "u-turn", [f"u-turn {level}" for level in TASKS["u-turn"].levels]),
        ("second", "mixed-seen", "all tasks", ()),
        ("standard", "treatment", "all tasks", ()),
        ("standard", "dose50", "all tasks", ()),
        ("paper", "treatment", "lightest", LIGHTEST),
    ],
)
@pytest.mark.parametrize("traffic", ["risky", "regular"])
def test_an_effect_is_the_difference_of_the_agents_means(
    folder: str, arm: str, scope: str, wanted: Sequence[str], traffic: str
) -> None:
    there = [setting for setting, name in agents(folder) if name == arm]
    settings = [setting for setting in there if not wanted or setting in wanted]
    points = 100 * (
        mean(folder, "crashed", arm, traffic, settings)
        - mean(folder, "crashed", "control", traffic, settings)
    )
    assert effect(folder, "crashed", traffic, scope, arm).value == pytest.approx(points, abs=1e-9)


@pytest.mark.parametrize("folder", ["second", "standard"])
def test_an_effect_elsewhere_is_that_of_the_same_agents_there(folder: str) -> None:
    there = [mean(folder, "crashed", f"{arm}-on-replica", "risky") for arm in BOTH]
    found = effect(folder, "crashed", "risky", tested_on="replica")
    assert found.value == pytest.approx(100 * (there[1] - there[0]), abs=1e-9)


def test_speed_and_rates_are_the_agents_means() -> None:
    slower = mean("second", "mean_speed", "treatment", "risky") - mean(
        "second", "mean_speed", "control", "risky"
    )
    assert effect("second", "mean_speed", "risky").value == pytest.approx(slower)
    assert (
        rate("standard", "control", "risky", digits=6)
        == f"{100 * mean('standard', 'crashed', 'control', 'risky'):.6f}"
    )


def test_the_tables_of_tasks_are_the_agents_means() -> None:
    """All columns, in both traffics and elsewhere, in the cells of the pages."""
    head, _, *lines = pages.task_table("second").splitlines()
    columns = [cell.strip() for cell in head.strip("|").split("|")]
    for line in lines:
        cells = dict(zip(columns, (cell.strip() for cell in line.strip("|").split("|")), strict=True))
        task = cells["task"]
        wanted = [
            setting for setting, arm in agents("second") if arm == "control" and setting.split()[0] == task
        ]
        control, treated = (
            {
                name: 100 * mean("second", name, arm, cells["traffic"], wanted)
                for name in ("crashed", "mean_speed")
            }
            for arm in BOTH
        )
        for title, name, scale in (("crashes [%]", "crashed", 1.0), ("speed [m/s]", "mean_speed", 0.01)):
            shown = [float(value) for value in cells[title].partition(":")[0].split("→")]
            assert shown == pytest.approx([scale * control[name], scale * treated[name]], abs=0.0501)
        short = pages.change("second", "crashed", cells["traffic"], task, interval=True)
        shown = [float(value) for value in short.partition(":")[0].split("→")]
        assert shown == pytest.approx([control["crashed"], treated["crashed"]], abs=0.501)
        assert (CROSSINGS.get(task) is None) == (cells["enters [%]"] == "–")
        if task in CROSSINGS:
            entered = [
                fmean(
                    (rows["distance"] >= CROSSINGS[task]).mean()
                    for rows in drives("second", setting, "treatment", cells["traffic"])
                )
                for setting in wanted
            ]
            assert f"→{100 * fmean(entered):.0f}:" in cells["enters [%]"]
            assert (
                pages.share_of("second", "entered", cells["traffic"], task) == f"{100 * fmean(entered):.0f}"
            )
    assert len(lines) == 2 * len(TASKS)
    assert len(pages.task_table("second", away=True).splitlines()) == 2 + 3 * len(TASKS)
    assert len(pages.means_table("second").splitlines()) == 2 + 1 + len(TASKS)


def test_how_an_agent_opens_is_counted_from_its_stored_actions() -> None:
    opened = frontal = episodes = 0
    stored = pd.read_parquet(
        RESULTS / "second" / "episodes.parquet", columns=["cell", "traffic", "actions", "crash_type"]
    )
    names = [
        name
        for name in stored["cell"].unique()
        if re.match(r"sumo-two-way-5\+2-control-s\d+-[0-9a-f]{12}$", name)
    ]
    for row in stored[stored["cell"].isin(names) & (stored["traffic"] == "regular")].to_dict("records"):
        opened += "0" in row["actions"][:2]
        frontal += row["crash_type"] == "frontal"
        episodes += 1
    assert episodes == 2000
    setting = ("second", "two-way 5+2", "regular", "control")
    assert pages.opening(*setting, 0, 2) == f"{100 * opened / episodes:.0f}"
    assert pages.kinds_of_crash(*setting, "frontal") == f"{100 * frontal / episodes:.0f}"


@pytest.mark.parametrize("arm", ["dense", "dose25", "dose50", "dose75"])
def test_the_mean_of_the_lightest_settings_is_pooled_as_the_analysis_does(arm: str) -> None:
    """Arms that are in the lightest traffic alone: the analysis has their mean over all settings."""
    assert {setting for setting, name in agents("standard") if name == arm} == set(LIGHTEST)
    for traffic in ("risky", "regular"):
        here, there = (
            effect("standard", "crashed", traffic, scope, arm) for scope in ("lightest", "all tasks")
        )
        assert (here.value, here.low, here.high) == pytest.approx((there.value, there.low, there.high))


@pytest.mark.parametrize(
    ("folder", "setting", "arm"),
    [
        ("standard", "u-turn 3", "treatment"),
        ("first-clock", "roundabout 5", "treatment"),
        ("second", "u-turn 3", "control"),
    ],
)
def test_late_crashes_are_counted(folder: str, setting: str, arm: str) -> None:
    late = crashes = 0
    for rows in drives(folder, setting, arm, "regular"):
        for crashed, time in zip(rows["crashed"], rows["crash_time"], strict=True):
            crashes += crashed
            late += crashed and time > {"u-turn": 10, "roundabout": 11}[setting.split()[0]] - 1
    assert pages.late_crashes(folder, setting, arm) == pages.Count(late, crashes)


def test_shares_of_avoidable_crashes_have_wilsons_intervals() -> None:
    stored = pd.read_parquet(RESULTS / "copies" / "avoidable.parquet")
    lines = {name: cells for name, *cells in pages.avoidable()}
    assert len(lines) == stored["task"].nunique() and set(stored["arm"]) == {"control", "treatment"}
    own = [row for row in stored.to_dict("records") if (row["task"], row["arm"]) == ("u-turn", "control")]
    assert {row["cell"] for row in own} == {own[0]["cell"]}
    avoided = sum(row["contact"] - row["last"] <= 2 for row in own)
    low, high = proportion_confint(avoided, len(own), method="wilson")
    assert lines["u-turn 3"][0] == f"{avoided / len(own):.0%} [{100 * low:.0f}, {100 * high:.0f}]"
    earlier = (stored["contact"] - stored["last"] <= 3).groupby(stored["task"]).mean()
    assert earlier.drop("two-way").min() > 0.9 and earlier["two-way"] == pytest.approx(0.5, abs=0.05)


def test_planners_crash_in_regular_traffic_on_the_two_way_road_alone() -> None:
    """docs/learner.md; all of them drive the same scenarios."""
    stored = pd.read_parquet(RESULTS / "copies" / "planners.parquet")
    scenarios = pages.planner_scenarios()
    driven = stored.groupby(["task", "traffic", "policy"])["scenario"].apply(sorted)
    assert len(driven) == 15 and all(numbers == scenarios for numbers in driven)
    assert set(stored[stored["crashed"] & (stored["traffic"] == "regular")]["task"]) == {"two-way"}


def test_other_learners_are_told_with_all_their_trainings() -> None:
    stored = pd.read_parquet(RESULTS / "other-learners" / "trainings.parquet")
    lines = {name: cells for name, *cells in pages.other_learners()}
    for learner, cells in lines.items():
        of_task = stored[(stored["traffic"] == "risky") & (stored["learner"] == learner)].groupby("task")
        assert (of_task["training"].nunique() == 3).all() and len(of_task) == len(cells)
    ppo = stored.query("learner == 'sb3-ppo' and traffic == 'risky' and task == 'u-turn'")
    assert lines["sb3-ppo"][-1] == f"{fmean(ppo['crashed']):.2f}"


def test_the_choice_of_the_learner_is_told_as_it_was_stored() -> None:
    runs = pd.read_parquet(RESULTS / "choice" / "runs.parquet").to_dict("records")
    own = [row for row in runs if (row["task"], row["variant"]) == ("u-turn", "one-64")]
    ended = [row["return"] / 10 for row in own if row["share"] == 1.0]
    before = [row["return"] / 10 for row in own if row["share"] == 0.75 and row["arm"] == "control"]
    after = [row["return"] / 10 for row in own if row["share"] == 1.0 and row["arm"] == "control"]
    found = pages.variant("one-64", "u-turn")
    assert found["score"] == pytest.approx(fmean(ended))
    assert found["control"] == pytest.approx(fmean(after) - fmean(before))
    assert found["largest"] == pytest.approx(max(row["largest_q"] / row["q_bound"] for row in own))


def test_doses_in_units_of_the_road_are_those_of_the_table() -> None:
    stored = pq.read_table(RESULTS / "road-units.parquet").to_pylist()
    highway = [line for line in stored if line["task"] == "highway"]
    assert [line["traffic"] for line in highway] == ["0", "0.25", "0.5", "0.75", "1", "measured"]
    shown = map(float, pages.road_units("highway", "lane_changes", 2).split(" | "))
    assert list(shown) == pytest.approx([highway[k]["lane_changes"] for k in (0, 4, 5)], abs=0.0051)


def test_the_checks_of_the_validation_are_counted() -> None:
    verdict = json.loads((ROOT / "experiments" / "validation" / "verdict.json").read_text())
    numbers = [own["counts"] for own in verdict.values()]
    found = pages.validation()
    assert found["all"] == sum(sum(own.values()) for own in numbers)
    assert (
        found["missed"]
        == sum(len(own["missed"]) for own in verdict.values())
        == found["all"] - found["passed"]
    )


@pytest.mark.parametrize("folder", STUDIES)
def test_gates_are_counted_agent_by_agent(folder: str) -> None:
    both = [own for (name, arm), own in agents(folder).items() if name in LIGHTEST and arm in BOTH]
    assert pages.passing(folder, scope="lightest").of == sum(map(len, both))


# -- what pages say in words -------------------------------------------------------------------------------------------
# Not how they say it: when such a test fails, a result has changed, and the pages named have to be read again.


def open_or_harmful(folder: str, arm: str, traffic: str, harm: bool) -> list[str]:
    """The settings in which a difference in crashes is open, or (harm) decided to be more crashes."""
    rows = pages.analysis(folder).effects
    rows = rows[(rows["arm"] == arm) & (rows["against"] == "control") & (rows["outcome"] == "crashed")]
    rows = rows[
        (rows["term"] == traffic) & (rows["scenarios"] == "own") & (rows["tested_on"] == rows["backend"])
    ]
    found = rows["p_adjusted"] < 0.05 if harm else rows["p_adjusted"] >= 0.05
    rows = rows[found & ((rows["estimate"] > 0) | (not harm))]
    return sorted(rows["task"] + " " + rows["level_name"])


def test_where_the_second_study_finds_gains_and_harms() -> None:
    """README and docs/study.md: the dense highway is open; the two-way road and three dense settings have a price."""
    for arm in ("treatment", "mixed"):
        assert open_or_harmful("second", arm, "risky", harm=False) == ["highway 150"]
    harms = open_or_harmful("second", "treatment", "regular", harm=True)
    assert harms == ["highway 150", "intersection 25", "intersection 30", "two-way 5+2"]
    falls = pages.analysis("second").effects.query(
        "arm == 'treatment' and against == 'control' and outcome == 'return' and term == 'sum' "
        "and scenarios == 'own' and estimate < 0 and p_adjusted < 0.05"
    )
    assert (falls["task"] + " " + falls["level_name"]).tolist() == ["intersection 30"]


def test_which_tasks_keep_the_price_below_its_margin() -> None:
    """docs/study.md says on which tasks mixed training stays within the limits of the plan."""
    rows = pages.analysis("second").price
    holds = {
        traffic: set(rows[(rows["term"] == traffic) & (rows["verdict"] == "holds")]["scope"])
        for traffic in ("risky", "regular")
    }
    assert holds == {
        "risky": {"highway", "two-way", "intersection"},
        "regular": {"highway", "roundabout", "u-turn"},
    }


def test_what_the_second_study_finds_in_other_traffic() -> None:
    """docs/study.md: drivers of other models everywhere safer; without events safer on roundabout and intersection."""
    rates = pages.policies("second").pivot_table("crashed", ["traffic", "task", "level_name"], "who")
    alone = rates.loc["only-parameters"]
    assert (
        alone.loc[["roundabout", "intersection"], "treatment"]
        < alone.loc[["roundabout", "intersection"], "control"]
    ).all()
    models = rates.loc[["krauss", "eidm"]]
    assert models[["treatment", "mixed"]].lt(models["control"], axis=0).all(axis=None)


def test_what_the_second_study_says_of_its_learner() -> None:
    """docs/study.md: Q-values exceed the bound on the two-way road alone."""
    study = pages.analysis("second")
    planned = study.gates[study.gates["arm"].isin(["control", "treatment", "mixed"])]
    assert set(planned.loc[planned["q_bounded"].eq(False), "task"]) == {"two-way"}


def test_the_table_of_all_folders_names_each_published_one() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "first-study.md"], "On highway-env's physics"))
    assert sorted(rows) == [f"results/{name}" for name in STUDIES]


def test_highway_env_gives_the_replicas_agents_the_same_returns() -> None:
    """docs/first-study.md: 2,000 episodes of the replica's agents, driven in highway-env itself, to the last bit."""
    rows = pd.read_parquet(RESULTS / "replica" / "episodes.parquet")
    names = rows["cell"].str.extract(r"(?P<agent>.+-s\d+)(?P<place>-on-highway-env)?-[0-9a-f]{12}$")
    rows = rows.assign(**names).dropna(subset=["agent"]).set_index(["agent", "traffic", "scenario"])
    same = ["return", "length", "crashed"]
    there = rows[rows["place"].notna()][same]
    assert len(there) == 2000
    here = rows[rows["place"].isna()][same]
    pd.testing.assert_frame_equal(here.loc[there.index], there, check_exact=True)
