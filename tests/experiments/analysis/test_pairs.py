"""Two agents together, compared within each training seed: against sums by hand, and against what was planted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments import report
from experiments.analysis.analysis import SHOWN, analyse
from experiments.analysis.claims import CONTRADICTED, HOLDS, NOT_DECIDED, price
from experiments.analysis.effects import contrasts
from experiments.analysis.pairs import COMPARED, influence, units
from experiments.analysis.plan import ENDS, STUDY
from experiments.analysis.scores import arms_of
from experiments.reporting import tables
from experiments.study.design.arms import ARMS, PAIRS, REGISTERED
from experiments.study.design.sheet import GRID
from experiments.study.results.loaded import load
from tests.experiments import synthetic
from tests.experiments.analysis.made_up import crashes

SEEDS, SCENARIOS = 5, 60
Rates = tuple[float, float]  # of crashes, in regular and in risky traffic
RATES: dict[str, Rates] = {"control": (0.1, 0.5), "treatment": (0.2, 0.3)}
KEPT: Rates = (0.1, 0.3)  # the gain without the price
ASKED = [*dict.fromkeys((bound.arm, bound.against) for bound in STUDY.price)]


def episodes(
    light: Rates = KEPT,
    dense: Rates = KEPT,
    scenarios: int = SCENARIOS,
    speed: float = 20.0,
    pairs: Sequence[str] = (REGISTERED,),
) -> pd.DataFrame:
    """Tests of five agents an arm and of what they do together, in the lightest and densest setting of every task."""
    random, drivers, crashed = np.random.default_rng(1), [], []
    for task, level_name in ENDS:
        is_light = level_name == GRID[task][0]
        rates = RATES | dict.fromkeys(pairs, light if is_light else dense)
        drawn = crashes(rates, random, 0.0, scenarios)
        for arm, k, (number, traffic) in product(rates, range(SEEDS), enumerate(("regular", "risky"))):
            crashed.append(drawn[arm]["crashed"][number, k])
            about = {"arm": arm, "seed": 300 + k, "traffic": traffic, "task": task, "level_name": level_name}
            about |= {"level": GRID[task].index(level_name) + 1, "kind": "test" if arm in PAIRS else "agent"}
            drivers.append({**about, "mean_speed": speed if arm in PAIRS else 20.0})
    frame = pd.DataFrame(drivers).astype({"seed": "Int64"}).assign(backend="sumo", tested_on="sumo")
    frame = frame.loc[frame.index.repeat(scenarios)].reset_index(drop=True)
    numbers = np.tile(np.arange(scenarios), len(drivers))
    return frame.assign(scenario=numbers, crashed=np.concatenate(crashed), **{"return": 1.0})


@pytest.fixture(scope="module")
def drives() -> pd.DataFrame:
    return episodes(pairs=[*PAIRS])


def judged(drives: pd.DataFrame, compared: Sequence[tuple[str, str]] = ASKED) -> pd.DataFrame:
    return contrasts(arms_of(units(drives)), dict.fromkeys(compared, SHOWN))


def in_tasks(found: pd.DataFrame) -> pd.DataFrame:
    return found[found["scope"] == "all tasks"]


class TestUnits:
    def test_they_are_the_pairs_and_their_agents_each_alone(self, drives: pd.DataFrame) -> None:
        found = units(drives)
        assert {*found["arm"]} == {*PAIRS, *ARMS} and {*found["seed"]} == {300, 301, 302, 303, 304}
        alone = drives[drives["kind"] == "agent"].assign(seed=lambda rows: rows["seed"] + 100)
        pd.testing.assert_frame_equal(units(pd.concat([drives, alone])), found)  # agents without a pair

    def test_pairs_that_are_not_complete_do_not_count(self, drives: pd.DataFrame) -> None:
        """Of the u-turn's third pair one test is missing, and of the highway's fourth an agent."""
        lost = (drives["task"] == "u-turn") & (drives["arm"] == "more-careful") & (drives["seed"] == 302)
        lost |= (drives["task"] == "highway") & (drives["arm"] == "control") & (drives["seed"] == 303)
        there = units(drives[~lost]).groupby("task")["seed"].unique()
        assert [*there["u-turn"]] == [300, 301, 303, 304] and [*there["highway"]] == [300, 301, 302, 304]
        assert len(there["two-way"]) == SEEDS


class TestQuestions:
    def test_a_difference_is_taken_within_each_seed(self, drives: pd.DataFrame) -> None:
        """The estimate and the part of its variance between pairs, from the table by hand."""
        one = drives.query("task == 'u-turn' and level == 1 and traffic == 'risky'")
        rates = one.groupby(["arm", "seed"])["crashed"].mean()
        difference = rates["pair"] - rates["treatment"]
        row = judged(drives).query(
            "task == 'u-turn' and level == 1 and arm == 'pair' and against == 'treatment' and term == 'risky'"
        )
        row = row[row["outcome"] == "crashed"].iloc[0]
        assert row["estimate"] == pytest.approx(difference.mean())
        assert row["variance"] >= difference.var(ddof=1) / SEEDS - 1e-12
        assert row["seeds_arm"] == row["seeds_against"] == SEEDS

    def test_an_agent_that_a_pair_only_repeats_has_no_variance_of_its_own(self, drives: pd.DataFrame) -> None:
        """Pairs that drive as their treated agents: the difference is 0, whatever the agents are."""
        treated = drives[drives["arm"] == "treatment"]
        same = pd.concat([treated.assign(arm=name, kind="test") for name in PAIRS])
        compared = [pair for pair in COMPARED if pair[1] == "treatment"]
        rows = judged(pd.concat([drives[drives["kind"] == "agent"], same]), compared)
        crashes = rows[rows["outcome"] == "crashed"]
        assert (crashes["estimate"] == 0).all() and (crashes["variance"] == 0).all()

    def test_bounds_are_one_sided_limits_of_the_mean_over_tasks(self, drives: pd.DataFrame) -> None:
        effects = judged(drives)
        found = in_tasks(price(effects, STUDY)).query("where == 'lightest' and term == 'risky'")
        [row] = found.itertuples()
        tasks = effects.query("arm == 'pair' and against == 'treatment' and term == 'risky' and level == 1")
        tasks = tasks[tasks["outcome"] == "crashed"]
        variance = tasks["variance"].sum() / 25
        dof = variance**2 / ((tasks["variance"] / 25) ** 2 / tasks["dof"]).sum()
        assert row.estimate == pytest.approx(tasks["estimate"].mean())
        assert row.high == pytest.approx(row.estimate + stats.t.ppf(0.95, dof) * variance**0.5)
        assert row.low == pytest.approx(row.estimate - stats.t.ppf(0.95, dof) * variance**0.5)
        power = stats.nct.sf(stats.t.ppf(0.95, dof), dof, row.detectable / variance**0.5)
        assert power == pytest.approx(0.8, abs=1e-3)

    @pytest.mark.parametrize(
        ("light", "dense", "verdicts"),
        [
            (KEPT, (0.3, 0.5), (HOLDS, HOLDS, CONTRADICTED, CONTRADICTED)),
            ((0.1, 0.5), KEPT, (HOLDS, CONTRADICTED, HOLDS, HOLDS)),  # no price, and no gain
            ((0.2, 0.3), KEPT, (CONTRADICTED, HOLDS, HOLDS, HOLDS)),  # all of the gain, at its price
            ((0.125, 0.35), KEPT, (NOT_DECIDED, NOT_DECIDED, HOLDS, HOLDS)),  # at the margins
        ],
    )
    def test_what_was_planted_is_found_where_it_was(
        self, light: Rates, dense: Rates, verdicts: tuple[str, ...]
    ) -> None:
        found = in_tasks(price(judged(episodes(light, dense, scenarios=400)), STUDY))
        assert len(found) == len(STUDY.price) and set(found["settings"]) == {5}
        verdict = found.set_index(["where", "term"])["verdict"]
        asked = product(("lightest", "densest"), ("regular", "risky"))
        assert tuple(verdict[place] for place in asked) == verdicts

    @pytest.mark.parametrize(("speed", "slow"), [(17.9, True), (18.1, False)])
    def test_a_pair_below_nine_tenths_of_the_speed_is_slow(self, speed: float, slow: bool) -> None:
        found = price(judged(episodes(speed=speed)), STUDY)
        assert set(found["slow"]) == {slow}
        assert set(zip(found["speed_arm"].round(6), found["speed_against"], strict=True)) == {(speed, 20.0)}

    def test_a_margin_that_is_the_truth_is_kept_to_in_one_of_twenty_studies(self) -> None:
        """And it lies between the limits in nine of ten."""
        random, repeats, rates = np.random.default_rng(5), 200, {**RATES, "pair": (0.125, 0.35)}
        places = {(str(k), "u-turn", 1, "3"): crashes(rates, random, 0.01) for k in range(repeats)}
        asked = {("pair", arm): [("crashed", "risky"), ("crashed", "regular")] for arm in ARMS}
        found = in_tasks(price(contrasts(places, asked), STUDY))
        assert len(found) == 2 * repeats
        held = found["verdict"].eq(HOLDS).groupby(found["term"]).sum()
        assert 0 < held.max() < repeats * 0.05 + 4 * np.sqrt(repeats * 0.05 * 0.95)
        covered = found.eval("low < margin < high").sum()
        assert covered >= stats.binom.ppf(1e-4, 2 * repeats, 0.9)


class TestInfluence:
    """Does an answer hang on one pair?"""

    def test_a_row_is_the_bound_of_the_episodes_without_that_pair(self, drives: pd.DataFrame) -> None:
        found = influence(drives, STUDY)
        assert len(found) == SEEDS * len(GRID) * 2
        kept = units(drives)
        kept = kept[(kept["task"] != "two-way") | (kept["seed"] != 303)]
        alone = contrasts(arms_of(kept), dict.fromkeys(ASKED, SHOWN))
        expected = in_tasks(price(alone, STUDY)).query("where == 'lightest'")
        row = found.query("left_task == 'two-way' and left_seed == 303")
        columns = ["against", "estimate", "low", "high", "verdict", "settings"]
        pd.testing.assert_frame_equal(
            row[columns].sort_values("against", ignore_index=True),
            expected[columns].sort_values("against", ignore_index=True),
        )

    def test_a_pair_that_hides_the_answer_is_found(self, drives: pd.DataFrame) -> None:
        """One pair of the highway that never crashes: without it the pairs are as bad as planted."""
        bad = episodes((0.3, 0.5), scenarios=400)
        odd = (bad["task"] == "highway") & (bad["arm"] == "pair") & (bad["seed"] == 301)
        found = influence(bad.assign(crashed=bad["crashed"].where(~odd, 0.0)), STUDY)
        regular = found.query("against == 'control'").set_index(["left_task", "left_seed"])
        assert regular["estimate"].idxmax() == ("highway", 301)
        assert regular.loc[("highway", 301), "verdict"] == CONTRADICTED
        assert regular["low"].idxmax() == ("highway", 301)


@pytest.fixture
def home(tmp_path: Path, words_alone: None) -> Path:
    """Two of the five lightest settings, with pairs."""
    levels = {"u-turn": (1,), "roundabout": (1,)}
    synthetic.write(tmp_path, levels, tests=12, seeds=3, pairs=True, preset="study")
    return tmp_path


def test_a_report_answers_the_question_and_has_a_row_for_everybody_who_drives(home: Path) -> None:
    found = analyse(load(home))
    assert found.plan["version"] == 5 and not found.notes["left_out"]
    assert len(in_tasks(found.price)) == 2  # in the lightest settings
    text = report.write_report(home).read_text()
    assert "Does a pair of a control and a treated agent" in text
    assert "it is an estimate and not a test" in text  # of five settings two are there
    rates = tables.pairs(found, "sumo").set_index("who drives")
    assert len(rates) == len(PAIRS) + 2
    rows = found.policies.query("arm == 'more-careful' and traffic == 'risky'")
    risky = rates.loc[tables.WHO_DRIVES["more-careful"], "crashes in risky traffic"]
    assert len(rows) == 2 and risky == tables.number(rows["crashed"].mean(), "crashed")
    lost = (found.policies["arm"] == "weighed") & (found.policies["task"] == "u-turn")
    fewer = tables.pairs(replace(found, policies=found.policies[~lost]), "sumo")
    # a mean over fewer tasks is not put beside the others
    assert {*rates.index} - {*fewer["who drives"]} == {tables.WHO_DRIVES["weighed"]}
    shown = tables.bounds(found, "sumo")
    assert len(shown) == 2 * 3 and tables.bounds(found, "sumo", "densest").empty
