"""The table of tasks: against plain pandas, against the effects of the plan, and what its means are made of."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.by_task import COLUMNS, SURROGATES, by_task
from experiments.analysis.effects import ESTIMATE, MEANS, contrasts, means
from experiments.analysis.plan import DEFAULT, OUTCOMES
from experiments.analysis.scores import arms_of, with_outcomes
from experiments.study.design import attainable
from experiments.study.design.sheet import GRID, SHEETS
from experiments.study.results.loaded import Results
from experiments.support.errors import UserError
from tests.experiments.analysis.made_up import PAIR

LEVELS = {"highway": (1,), "roundabout": (1, 2), "u-turn": (1,)}
MADE_UP = {"levels": LEVELS, "seeds": 4, "tests": 30, "effect": -0.3, "test_on": ("replica",)}
MADE_UP |= {"further": ("mixed",), "baselines": ("careful",)}


@pytest.fixture(scope="module")
def episodes(results: Results) -> pd.DataFrame:
    """With a traffic that nobody was trained in, in which every second crash of risky traffic does not happen."""
    found = with_outcomes(results, {**COLUMNS, **SURROGATES})
    unseen = found[(found["kind"] == "agent") & (found["traffic"] == "risky")]
    unseen = unseen.assign(kind="test", traffic="only-parameters")
    for name in ("crashed", "hard_crash"):
        unseen[name] *= unseen["scenario"] % 2
    return pd.concat([found, unseen], ignore_index=True)


@pytest.fixture(scope="module")
def table(episodes: pd.DataFrame) -> pd.DataFrame:
    return by_task(episodes, outcomes={**COLUMNS, **SURROGATES})


def plain_means(rows: pd.DataFrame) -> pd.Series:
    """Of one arm in one traffic, by outcome: over episodes of an agent, agents, levels of a task, tasks."""
    crossing = rows["task"].map({task: own.crossing for task, own in SHEETS.items()}).astype(float)
    scores = rows.assign(
        hard_crash=(rows["crashed"] == 1) & (rows["crash_closing_speed"] >= 10),
        entered=rows["distance"] >= crossing,
        close=rows["min_ttc"] < 1.0,
    )
    agents = scores.groupby(["task", "level", "seed"])
    value = agents.mean(numeric_only=True)
    value["crashes_per_100_km"] = 1e5 * agents["crashed"].sum() / agents["distance"].sum()
    value["near_misses_per_km"] = 1e3 * agents["near_misses"].sum() / agents["distance"].sum()
    return value.groupby(["task", "level"]).mean().groupby("task").mean().mean()


def test_every_number_is_the_mean_that_plain_pandas_finds(
    episodes: pd.DataFrame, table: pd.DataFrame
) -> None:
    places = {("sumo", "regular"), ("sumo", "risky"), ("replica", "regular"), ("replica", "risky")}
    assert {*zip(table["tested_on"], table["traffic"], strict=True)} == places | {("sumo", "only-parameters")}
    for (place, traffic, scope), rows in table.groupby(["tested_on", "traffic", "scope"]):
        there = episodes[episodes["tested_on"].eq(place) & episodes["traffic"].eq(traffic)]
        if scope.startswith("without "):
            there = there[there["task"] != scope.removeprefix("without ")]
        elif scope != "all tasks":
            there = there[there["task"] == scope]
        control, own = (plain_means(there[there["arm"] == name]) for name in ("control", "treatment"))
        for row in rows.to_dict("records"):
            if (name := row["outcome"]) == "crashes_per_100_km" and traffic == "only-parameters":
                continue  # computed before the crashes were taken out
            assert (row["mean_against"], row["mean_arm"]) == pytest.approx((control[name], own[name]))
            assert row["estimate"] == pytest.approx(own[name] - control[name])


def test_it_has_the_intervals_of_the_effects(
    results: Results, episodes: pd.DataFrame, table: pd.DataFrame
) -> None:
    """The plan's own means, which have the same estimator: at home, and of the tests elsewhere as if they were home."""
    analysis: Analysis = analyse(results)
    away = episodes[(episodes["tested_on"] == "replica") & episodes["arm"].isin(PAIR)]
    elsewhere = means(contrasts(arms_of(away), {PAIR: [("crashed", "risky"), ("crashed", "regular")]}))
    key = ["arm", "against", "scope", "outcome", "traffic"]
    for place, own, least in (("sumo", analysis.means, 30), ("replica", elsewhere, 8)):
        both = own.rename(columns={"term": "traffic"})
        same = table[table["tested_on"] == place].merge(both, on=key, suffixes=("", " then"))
        assert len(same) >= least
        for column in (*ESTIMATE[:-1], *MEANS):
            assert same[column].astype(float).tolist() == pytest.approx(
                same[f"{column} then"].astype(float).tolist(), nan_ok=True
            )
    assert len(analysis.by_task) == (table["traffic"] != "only-parameters").sum()


def test_an_episode_is_close_below_one_second() -> None:
    of = SURROGATES["close"].of
    assert of and of(pd.DataFrame({"min_ttc": [0.0, 0.99, 1.0, float("inf")]})).tolist() == [1, 1, 0, 0]


def test_a_share_of_almost_no_crashes_has_an_interval(episodes: pd.DataFrame) -> None:
    """Where nobody crashes, or hard, the difference is 0 and its interval is not, but within the margin."""
    calm = episodes.assign(crashed=0.0, hard_crash=0.0)
    rows = by_task(calm).query("outcome in ('crashed', 'hard_crash') and scope == 'u-turn'")
    assert set(rows["outcome"]) == {"crashed", "hard_crash"} and (rows["estimate"] == 0).all()
    assert (rows["low"] < 0).all() and rows["high"].between(0, OUTCOMES["crashed"].margin, "neither").all()


def test_an_agent_that_is_lost_at_home_counts_nowhere(episodes: pd.DataFrame) -> None:
    lost = (episodes["kind"] == "agent") & (episodes["arm"] == "treatment") & (episodes["seed"] == 3)
    found = by_task(episodes[~lost]).query("arm == 'treatment' and scope == 'u-turn'")
    assert set(found["seeds_arm"]) == {3} and set(found["tested_on"]) == {"sumo", "replica"}


def test_a_setting_that_the_plan_does_not_name_is_in_no_mean(
    episodes: pd.DataFrame, table: pd.DataFrame
) -> None:
    light = replace(DEFAULT, settings=tuple((task, GRID[task][0]) for task in GRID))
    rows = by_task(episodes, light).query("arm == 'treatment' and tested_on == 'sumo' and traffic == 'risky'")
    assert rows.query("scope == 'roundabout' and outcome == 'crashed'")["settings"].tolist() == [1]
    alone = by_task(episodes[episodes["level"] == 1]).query("scope == 'all tasks' and outcome == 'crashed'")
    assert (
        rows.query("scope == 'all tasks' and outcome == 'crashed'")["estimate"].item()
        in alone["estimate"].tolist()
    )


def test_an_episode_that_is_there_twice_is_an_error(episodes: pd.DataFrame) -> None:
    with pytest.raises(UserError, match="both test one agent"):
        by_task(pd.concat([episodes, episodes[episodes["kind"] == "agent"].head(1)]))


def test_what_a_task_has_no_number_of_is_left_out(table: pd.DataFrame) -> None:
    rows = table[(table["tested_on"] == "sumo") & (table["traffic"] == "risky")]
    there = rows.groupby("outcome")["scope"].agg(set)
    tasks = {*LEVELS}
    means = {"all tasks", *(f"without {task}" for task in tasks)}
    assert there["entered"] == {"roundabout"}  # the other two have no crossing
    assert there["return"] == there["crashes_per_100_km"] == tasks  # they mean something else on each task
    for outcome in ("crashed", "hard_crash", "mean_speed"):
        assert there[outcome] == tasks | means


def test_an_episode_without_a_crash_lasts_its_steps_by_the_policy_frequency() -> None:
    episodes = pd.DataFrame(
        {"cell": ["slow", "fast"], "traffic": "regular", "crashed": False, "crash_time": float("nan")}
    )
    episodes = episodes.assign(length=20, distance=100.0, task="u-turn", level_name="3", **{"return": 1.0})
    configs = {"slow": {"duration": 20}, "fast": {"duration": 10, "policy_frequency": 2}}
    key = {"backend": "sumo", "task": "u-turn", "level": 1}
    cells = {name: {"key": {**key, "env_config": config}} for name, config in configs.items()}
    results: Any = SimpleNamespace(episodes=episodes, cells=cells)
    found = with_outcomes(results, {})
    assert found[["crash_free_time", "seconds", "progress"]].values.tolist() == [
        [20.0, 20.0, 5.0],
        [10.0, 10.0, 10.0],
    ]


def test_scores_stand_beside_returns_where_there_are_marks(results: Results, monkeypatch) -> None:
    """Only of tests like those of the marks: on SUMO, and with nothing else configured."""
    drivers = {"IDLE": {"kind": "constant", "return": 2.0}, "planner": {"kind": "policy", "return": 6.0}}
    monkeypatch.setattr(attainable, "stored", lambda: {"u-turn 3 regular": {"drivers": drivers}})
    other = next(name for name in results.cells if "u-turn-3-control" in name)
    key = results.cells[other]["key"]
    config = {**key["env_config"], "collision_reward": -2.0}
    cells = {**results.cells, other: {**results.cells[other], "key": {**key, "env_config": config}}}
    found = with_outcomes(replace(results, cells=cells), {**COLUMNS, **SURROGATES})
    marked = (found["task"] == "u-turn") & (found["traffic"] == "regular") & (found["tested_on"] == "sumo")
    expected = ((found["return"] - 2.0) / 4.0).where(marked & (found["cell"] != other))
    pd.testing.assert_series_equal(found["score"], expected, check_names=False)
    rows = by_task(with_outcomes(results, {**COLUMNS, **SURROGATES}))
    rows = rows[rows["tested_on"] == "sumo"].set_index(["outcome", "scope", "traffic"])
    value, score = (rows.loc[(name, "u-turn", "regular")] for name in ("return", "score"))
    assert score["mean_arm"] == pytest.approx((value["mean_arm"] - 2.0) / 4.0)
    assert score["low"] == pytest.approx(value["low"] / 4.0)
    assert not {"highway", "roundabout"} & set(rows.loc["score"].index.get_level_values("scope"))
