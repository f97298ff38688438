"""Mistakes that an independent check of the first edition's statistics found: each test fails with that edition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from experiments.reporting.report_view import effect_rows
from scipy import stats

from experiments import report
from experiments.analysis.analysis import analyse
from experiments.analysis.verdicts import claims
from experiments.study import store
from experiments.study.results import load
from sumo_env.tasks import TASKS
from tests.experiments import synthetic

LEVELS = {"highway": (1,), "u-turn": (1, 2, 3, 4)}
SEEDS = 6


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    directory = tmp_path_factory.mktemp("results")
    synthetic.write(directory, LEVELS, seeds=SEEDS, tests=40, effect=0.0)
    return load(directory)


def changed(results, **columns):
    """The results with other test episodes: each column a function of the table, for the trained agents."""
    episodes = results.episodes.copy()
    agents = episodes["kind"] == "agent"
    for column, value in columns.items():
        own = episodes.loc[agents]
        episodes[column] = episodes[column].astype(object)
        episodes.loc[agents, column] = value(own)
        episodes[column] = episodes[column].astype(results.episodes[column].dtype)
    return replace(results, episodes=episodes)


def find(records, **wanted):
    (found,) = [r for r in records if all(r[key] == value for key, value in wanted.items())]
    return found


def test_the_slope_of_the_outcome_knows_that_each_level_has_test_scenarios_of_its_own(results):
    """Agents that hardly differ, and scenarios that do: nothing grows with traffic."""
    random = np.random.default_rng(5)
    luck = random.normal(0, 2.0, (6, 40))
    noise = random.normal(0, 0.05, len(results.episodes))

    def returns(rows: pd.DataFrame) -> np.ndarray:
        return 10 + luck[rows["level"], rows["scenario"]] + noise[: len(rows)]

    slope = find(
        analyse(changed(results, **{"return": returns}))["slopes"],
        task="u-turn", outcome="return", quantity="mean",
    )  # fmt: skip
    assert slope["high"] - slope["low"] > 0.2
    assert slope["low"] < 0 < slope["high"]


def test_a_treatment_that_ruins_agents_is_no_success(tmp_path):
    """On one task all treated agents fail the gates, and crash: the answer counts them."""
    faults = {f"sumo-highway-50-treatment-s{seed}": "poor" for seed in range(4)}
    synthetic.write(tmp_path, {"highway": (1,), "u-turn": (1,)}, seeds=4, tests=40, effect=0.0, faults=faults)
    loaded = load(tmp_path)
    ruined = changed(
        loaded,
        crashed=lambda rows: rows["crashed"] | ((rows["task"] == "highway") & (rows["arm"] == "treatment")),
    )
    (headline,) = analyse(ruined)["headlines"]
    assert headline["answer"] == "less safe"
    assert "4 of 8 treated and 0 of 8 control agents fail the gates" in " ".join(headline["text"])


def test_one_agent_that_fails_does_not_void_its_setting(tmp_path):
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=4, faults={"sumo-u-turn-3-control-s1": "poor"})
    record = find(analyse(load(tmp_path))["ate"], outcome="return", term="sum")
    assert record["status"] == "ok"
    assert record["failed"] == [0, 1]


def test_the_printed_formula_has_the_printed_signs(results):
    """T(risky) + T(regular) - C(risky) + C(regular), with control agents that get less in risky traffic."""
    unlike = changed(results, **{"return": lambda rows: rows["return"] - 5 * (rows["traffic"] == "risky")})
    record = find(analyse(unlike)["ate"], task="highway", outcome="return", term="sum")
    rows = unlike.episodes.query("task == 'highway' and kind == 'agent'")
    mean = rows.groupby(["arm", "traffic"])["return"].mean()
    printed = sum(mean["treatment"]) - mean["control", "risky"] + mean["control", "regular"]
    assert record["literal"] == pytest.approx(printed)


class TestNeverCrashed:
    def test_is_evidence(self, results):
        safe = changed(results, crashed=lambda rows: rows["crashed"] & (rows["arm"] == "control"))
        for term in ("risky", "regular", "sum"):
            record = find(analyse(safe)["ate"], task="highway", outcome="crashed", term=term)
            assert record["status"] == "ok"
            assert record["high"] < 0

    def test_in_both_arms_is_equivalence(self, results):
        safe = changed(results, crashed=lambda rows: rows["crashed"] & False)
        record = find(analyse(safe)["ate"], task="highway", outcome="crashed", term="regular")
        assert record["estimate"] == 0
        assert record["low"] < 0 < record["high"]
        assert record["equivalence_p"] < 0.05


def test_a_slope_over_some_of_the_levels_decides_nothing():
    grid = {task: len(definition.levels) for task, definition in TASKS.items()}
    found = {
        "backend": "sumo", "outcome": "return", "quantity": "mean", "levels": [1, 2], "complete": False,
        "estimate": -1.0, "low": -2.0, "high": -0.1, "p": 1e-6, "p_adjusted": 1e-5, "status": "ok", "cells": [],
    }  # fmt: skip
    effect = {"backend": "sumo", "outcome": "none", "term": "none", "task": "highway"}
    for sign in (1, -1):
        slopes = [{**found, "task": task, "estimate": sign} for task in grid]
        claim = find(claims([effect], slopes, grid), claim="The return falls as traffic grows, on every task")
        assert claim["verdict"] == "not decided"


def test_the_detectable_effect_is_the_one_at_the_level_that_decides(results):
    records = [r for r in analyse(results)["ate"] if r.get("detectable")]
    assert records
    for record in records:
        family = [r for r in records if r["family"] == record["family"]]
        limit = stats.t.ppf(1 - 0.05 / len(family) / 2, record["df"])
        power = stats.nct.sf(limit, record["df"], record["detectable"] / record["se"])
        assert power == pytest.approx(0.8, abs=1e-3)


def test_there_is_no_percentage_of_a_negative_mean(results):
    """From -5 to -3 is better, and not 40 % worse."""
    negative = changed(
        results,
        **{"return": lambda rows: -5 + 2 * (rows["arm"] == "treatment") + rows["return"] / 100},
    )
    record = find(analyse(negative)["ate"], task="highway", outcome="return", term="sum")
    assert record["estimate"] > 3
    assert record["percent"]["estimate"] is None
    assert "above 0" in record["percent"]["reason"]


class TestIncompleteData:
    @pytest.fixture
    def name(self, results):
        return next(name for name in results.cells if "u-turn-3-treatment" in name)

    @pytest.mark.parametrize(
        ("damage", "words"),
        [
            (lambda rows: rows.assign(**{"return": rows["return"].where(rows["scenario"] > 3)}), "not a number"),
            (lambda rows: rows.assign(**{"return": np.inf}), "not a number"),
            (lambda rows: rows[rows["scenario"] < 7], "7 of 40 test scenarios in regular traffic"),
            (lambda rows: rows[rows["traffic"] == "regular"], "0 of 40 test scenarios in risky traffic"),
            (lambda rows: pd.concat([rows, rows.iloc[:1]]), "some twice"),
        ],
    )  # fmt: skip
    def test_is_named_and_not_counted(self, results, name, damage, words):
        own = results.episodes["cell"] == name
        episodes = pd.concat([results.episodes[~own], damage(results.episodes[own])], ignore_index=True)
        found = analyse(replace(results, episodes=episodes))
        assert [entry["cell"] for entry in found["incomplete"]] == [name]
        assert words in found["incomplete"][0]["reason"]
        record = find(found["ate"], task="u-turn", level=1, outcome="crashed", term="risky")
        assert record["seeds"] == [SEEDS - 1, SEEDS]

    def test_a_damaged_cell_does_not_stop_the_report(self, tmp_path):
        cells = synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=4)
        (tmp_path / "cells" / cells[0].name / store.EPISODES).write_bytes(b"")
        text = report.write_report(tmp_path).read_text()
        assert "1 cell cannot be read" in text
        assert f"{cells[0].name}" in text

    def test_the_same_agent_twice_is_noticed(self, results, name):
        others = [other for other in results.cells if "u-turn-3-treatment" in other]
        cells = {key: {**cell} for key, cell in results.cells.items()}
        for other in others[:2]:
            cells[other]["learner"] = {**cells[other]["learner"], "weights_sha256": "0"}
        assert analyse(replace(results, cells=cells))["duplicates"] == [sorted(others[:2])]


class TestAdjustment:
    def test_equivalence_is_adjusted_and_a_p_of_zero_counts(self, results):
        found = analyse(results)["ate"]
        row = [r for r in found if r["task"] == "highway" and r["outcome"] == "crashed"]
        for record in row:
            record["equivalence_p"] = 0.0
            record["equivalence_p_adjusted"] = 0.0
        assert effect_rows(row, "crashed")[0]["equivalent"]
        for record in row:
            record["equivalence_p_adjusted"] = 0.06
        assert not effect_rows(row, "crashed")[0]["equivalent"]

    def test_the_interval_at_holms_level_agrees_with_holms_p(self, results):
        tested = [r for r in analyse(results)["ate"] if r["family"]]
        assert len(tested) == 2 * 5
        for record in tested:
            excludes = record["low_adjusted"] > 0 or record["high_adjusted"] < 0
            assert excludes == (record["p_adjusted"] < 0.05)
