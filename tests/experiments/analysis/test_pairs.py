"""Two agents together, compared pair by pair: against sums by hand, and against what was planted."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments import report
from experiments.analysis.analysis import CRASHES, analyse
from experiments.analysis.claims import CONTRADICTED, HOLDS, price
from experiments.analysis.effects import contrasts
from experiments.analysis.influence import influence
from experiments.analysis.pairs import COMPARED, units
from experiments.analysis.scores import arms_of
from experiments.reporting import tables
from experiments.study.design.arms import PAIRS
from experiments.study.results.store import load
from tests.experiments import synthetic
from tests.experiments.analysis.plans import BELIEF as PLAN
from tests.experiments.analysis.plans import MIXED

HALF, SCENARIOS = 5, 60
# Crash rates in regular and in risky traffic.
RATES = {"control": (0.1, 0.5), "treatment": (0.2, 0.3), "mixed": (0.15, 0.4)}
TOGETHER = {"belief": (0.1, 0.3), "half": (0.1, 0.4)}


def episodes(belief: tuple[float, float] = TOGETHER["belief"], scenarios: int = SCENARIOS) -> pd.DataFrame:
    """Tests of ten agents an arm and of five pairs of each kind, in the lightest setting of every task."""
    random, rows = np.random.default_rng(1), []
    for task, level_name in PLAN.settings:
        luck = random.uniform(size=(2, scenarios))
        drivers = [("agent", arm, 200 + k, RATES[arm]) for arm in RATES for k in range(2 * HALF)]
        drivers += [
            ("test", name, 200 + k, belief if name == "belief" else TOGETHER.get(name, RATES[pair.arms[1]]))
            for name, pair in PAIRS.items()
            for k in range(HALF)
        ]
        for (kind, arm, seed, rates), (number, traffic) in product(drivers, enumerate(("regular", "risky"))):
            mixed = np.where(
                random.uniform(size=scenarios) < 0.5, luck[number], random.uniform(size=scenarios)
            )
            table = pd.DataFrame({"scenario": np.arange(scenarios), "crashed": (mixed < rates[number]) * 1.0})
            rows.append(
                table.assign(kind=kind, arm=arm, seed=seed, traffic=traffic, task=task, level_name=level_name)
            )
    frame = pd.concat(rows, ignore_index=True).astype({"seed": "Int64"})
    return frame.assign(backend="sumo", tested_on="sumo", level=1, **{"return": 1.0, "mean_speed": 20.0})


@pytest.fixture(scope="module")
def drives() -> pd.DataFrame:
    return episodes()


def judged(drives: pd.DataFrame) -> pd.DataFrame:
    return contrasts(arms_of(units(drives)), dict.fromkeys(COMPARED, CRASHES))


class TestUnits:
    def test_a_single_agent_is_the_mean_of_the_two_of_a_pair(self, drives: pd.DataFrame) -> None:
        found = units(drives)
        assert {*found["arm"]} == {*PAIRS, "one-control", "one-treatment", "one-mixed"}
        assert {*found["seed"]} == {200, 201, 202, 203, 204}
        place = "task == 'u-turn' and traffic == 'risky' and scenario == 7"
        both = drives.query(f"{place} and kind == 'agent' and arm == 'treatment' and seed in (203, 208)")
        one = found.query(f"{place} and arm == 'one-treatment' and seed == 203")
        assert one["crashed"].tolist() == [both["crashed"].mean()] and len(both) == 2

    def test_a_setting_without_its_last_pair_keeps_who_belongs_together(self, drives: pd.DataFrame) -> None:
        """The fifth pair of the two-way road is not there: agent 205 is still 200's second, and not 201's."""
        lost = (drives["task"] == "two-way") & drives["seed"].isin((204, 209))
        there, whole = units(drives[~lost]), units(drives)
        kept = whole[(whole["task"] != "two-way") | (whole["seed"] != 204)]
        pd.testing.assert_frame_equal(there.reset_index(drop=True), kept.reset_index(drop=True))

    def test_pairs_that_are_not_complete_do_not_count(self, drives: pd.DataFrame) -> None:
        """Of the u-turn's third pair one test is missing, and of the highway's fourth an agent."""
        lost = (drives["task"] == "u-turn") & (drives["arm"] == "half") & (drives["seed"] == 202)
        lost |= (drives["task"] == "highway") & (drives["arm"] == "mixed") & (drives["seed"] == 208)
        there = units(drives[~lost]).groupby("task")["seed"].unique()
        assert [*there["u-turn"]] == [200, 201, 203, 204] and [*there["highway"]] == [200, 201, 202, 204]
        assert len(there["two-way"]) == HALF

    def test_other_traffic_and_other_simulators_do_not_count(self, drives: pd.DataFrame) -> None:
        tests = drives[drives["kind"] == "test"]
        more = pd.concat([drives, tests.assign(traffic="dose50"), tests.assign(tested_on="replica")])
        pd.testing.assert_frame_equal(units(more), units(drives))

    def test_a_study_without_pairs_has_none(self, drives: pd.DataFrame) -> None:
        alone = units(drives[drives["kind"] == "agent"])
        assert alone.empty and contrasts(arms_of(alone), dict.fromkeys(COMPARED, CRASHES)).empty


class TestQuestions:
    def test_a_difference_is_taken_within_pairs(self, drives: pd.DataFrame) -> None:
        """The estimate and the part of its variance between pairs, from the table by hand."""
        one = drives.query("task == 'u-turn' and traffic == 'risky'")
        rates = {
            name: one[(one["arm"] == name) & (one["kind"] == kind)].groupby("seed")["crashed"].mean()
            for name, kind in (("belief", "test"), ("treatment", "agent"))
        }
        single = [(rates["treatment"][200 + k] + rates["treatment"][205 + k]) / 2 for k in range(HALF)]
        difference = rates["belief"].to_numpy(dtype=float) - single
        found = judged(drives).query("task == 'u-turn' and arm == 'belief' and against == 'one-treatment'")
        row = found[found["term"] == "risky"].iloc[0]
        assert row["estimate"] == pytest.approx(difference.mean())
        assert row["variance"] >= difference.var(ddof=1) / HALF - 1e-12
        assert row["seeds_arm"] == row["seeds_against"] == HALF

    def test_bounds_are_one_sided_limits_of_the_mean_over_tasks(self, drives: pd.DataFrame) -> None:
        effects = judged(drives)
        [row] = price(effects, PLAN).query("against == 'two-treatment' and scope == 'all tasks'").itertuples()
        tasks = effects.query("arm == 'belief' and against == 'two-treatment' and term == 'risky'")
        variance = tasks["variance"].sum() / 25
        dof = variance**2 / ((tasks["variance"] / 25) ** 2 / tasks["dof"]).sum()
        assert row.estimate == pytest.approx(tasks["estimate"].mean())
        assert row.high == pytest.approx(row.estimate + stats.t.ppf(0.95, dof) * variance**0.5)

    @pytest.mark.parametrize(
        ("belief", "verdicts"),
        [((0.1, 0.3), {HOLDS}), ((0.3, 0.5), {CONTRADICTED})],
    )
    def test_what_was_planted_is_found(self, belief: tuple[float, float], verdicts: set[str]) -> None:
        found = price(judged(episodes(belief, 400)), PLAN).query("scope == 'all tasks'")
        assert {*found["verdict"]} == verdicts and len(found) == len(PLAN.price)


class TestInfluence:
    """Does an answer hang on one pair?"""

    def test_a_row_is_the_bound_of_the_episodes_without_that_pair(self, drives: pd.DataFrame) -> None:
        found = influence(drives, PLAN)
        assert len(found) == HALF * len(PLAN.settings) * len(PLAN.price)
        kept = units(drives)
        kept = kept[(kept["task"] != "two-way") | (kept["seed"] != 203)]
        alone = contrasts(arms_of(kept), dict.fromkeys(COMPARED, CRASHES))
        expected = price(alone, PLAN).query("scope == 'all tasks'")
        row = found.query("left_task == 'two-way' and left_seed == 203")[expected.columns]
        row = row.set_index("against").loc[expected["against"]].reset_index()[expected.columns]
        pd.testing.assert_frame_equal(row.reset_index(drop=True), expected.reset_index(drop=True))

    def test_a_pair_that_hides_the_answer_is_found(self, drives: pd.DataFrame) -> None:
        """One pair of the highway that never crashes: without it the belief is as bad as planted."""
        bad = episodes((0.3, 0.5), 400)
        odd = (bad["task"] == "highway") & (bad["arm"] == "belief") & (bad["seed"] == 201)
        found = influence(bad.assign(crashed=bad["crashed"].where(~odd, 0.0)), PLAN)
        regular = found.query("against == 'two-control'").set_index(["left_task", "left_seed"])
        assert regular["estimate"].idxmax() == ("highway", 201)
        assert regular.loc[("highway", 201), "verdict"] == CONTRADICTED
        assert regular["low"].idxmax() == ("highway", 201)

    def test_nothing_is_asked_of_a_study_without_pairs_or_of_one_pair(self, drives: pd.DataFrame) -> None:
        assert influence(drives[drives["kind"] == "agent"], PLAN).empty
        assert influence(drives[drives["seed"].isin([200, 205])], PLAN).empty
        assert influence(drives, MIXED).empty


def test_a_report_answers_the_questions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {"seeds": 4, "pairs": True, "preset": "of a belief"}
    synthetic.write(tmp_path, {"u-turn": (1,)}, tests=12, further=("mixed",), **asked)
    found = analyse(load(tmp_path))
    assert found.plan["version"] == 4 and not found.notes["left_out"]
    assert len(found.price.query("scope == 'all tasks'")) == len(PLAN.price)
    rows = found.means.query("arm == 'belief' and against == 'half' and scope == 'all tasks'")
    assert {*rows["outcome"]} == {"crashed", "mean_speed"} and len(rows) == 4
    assert {*found.policies["arm"]} >= {*PAIRS}
    monkeypatch.setattr("experiments.reporting.page.drawn", lambda *_: defaultdict(lambda: None))
    text = report.write_report(tmp_path).read_text()
    assert "weighed by a belief about the traffic" in text and "mix of both traffics" not in text
    assert "it is an estimate and not a test" in text  # of five settings one is there


def test_a_report_has_a_row_for_everybody_who_drives(tmp_path: Path) -> None:
    asked: dict[str, Any] = {"seeds": 4, "pairs": True, "preset": "of a belief"}
    synthetic.write(tmp_path, {"u-turn": (1,), "roundabout": (1,)}, tests=12, further=("mixed",), **asked)
    found = analyse(load(tmp_path))
    rates = tables.pairs(found, "sumo").set_index("who drives")
    assert len(rates) == len(PAIRS) + 3
    rows = found.policies.query("arm == 'two-treatment' and traffic == 'risky'")
    risky = rates.loc["two treated agents", "crashes in risky traffic"]
    assert len(rows) == 2 and risky == tables.number(rows["crashed"].mean(), "crashed")
    lost = (found.policies["arm"] == "two-mixed") & (found.policies["task"] == "u-turn")
    fewer = tables.pairs(replace(found, policies=found.policies[~lost]), "sumo")
    # a mean over fewer tasks is not put beside the others
    assert {*rates.index} - {*fewer["who drives"]} == {"two mixed agents"}
    against = tables.belief(found, "sumo").set_index("minus")
    bound = found.price.query("against == 'two-control' and scope == 'all tasks'").iloc[0]
    shown = against.loc["two control agents, regular traffic"]
    assert shown["mean of the tasks"] == tables.points(bound["estimate"], "crashed")
    assert (shown["allowed"], shown["answer"]) == ("below +2.5", bound["verdict"])
    assert len(against) == len(PLAN.price) + 2 and {"u-turn", "roundabout"} <= {*against.columns}
