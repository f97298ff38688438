"""From stored cells to effects, gates, verdicts: the numbers, their status, and their error rates."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis.analysis import analyse, summary_table
from experiments.analysis.effects import effects
from experiments.analysis.plan import (
    DEFAULT,
    FIRST,
    OUTCOMES,
    TERMS,
    TWO_BATCHES,
    Plan,
    as_data,
    digest,
    plan_of,
)
from experiments.analysis.pooling import failures, slopes
from experiments.analysis.sensitivity import learnt, second_batch, sensitivity
from experiments.analysis.statistics import interval, linear
from experiments.analysis.tables import Arm, comparable
from experiments.analysis.verdicts import claims, decide, decide_equivalence
from experiments.study.grid import BASELINES
from experiments.study.results import load
from sumo_env.tasks import TASKS
from tests.experiments import synthetic

FAULTS = {
    "sumo-highway-100-control-s0": "diverged",
    "sumo-highway-100-treatment-s2": "constant",
    "sumo-u-turn-3-control-s1": "tied",
    "sumo-u-turn-6-treatment-s3": "poor",
}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    directory = tmp_path_factory.mktemp("results")
    synthetic.write(directory, {"highway": (1, 2), "u-turn": (1, 2, 3)}, seeds=4, faults=FAULTS, effect=-0.2)
    return load(directory)


@pytest.fixture(scope="module")
def analysis(results):
    return analyse(results)


def find(records, **wanted):
    """The one record with these fields."""
    (found,) = [r for r in records if all(r[key] == value for key, value in wanted.items())]
    return found


def agents(levels, seeds, random, effect=0.0, spread=1.0, task="highway", growth=0.0):
    """Settings of one task, each agent with the same score in all scenarios of a traffic, in every outcome."""
    result = {}
    for level in range(1, levels + 1):
        pair = {}
        for arm in ("control", "treatment"):
            own = random.normal(0, spread, (1, seeds, 1)) + random.normal(0, 0.3 * spread, (2, seeds, 1))
            added = (effect + growth * level) * (arm == "treatment")
            scores = 10 + own + added + random.normal(0, 0.01 * spread, (2, seeds, 5))
            cells = tuple(f"{task}-{level}-{arm}-{seed}" for seed in range(seeds))
            pair[arm] = Arm(tuple(range(seeds)), cells, dict.fromkeys(OUTCOMES, scores))
        result["sumo", task, level, str(level)] = pair
    return result


def verdict(cell, passed, arm):
    """The verdict of the gates on an agent."""
    return {"cell": cell, "passed": passed, "arm": arm, "failed": [] if passed else ["q_bounded"], "gates": {
        name: {"passed": passed} for name in ("q_bounded", "not_constant", "crosses", "beats_constant")
    }}  # fmt: skip


class TestPlan:
    def test_is_in_the_analysis_with_its_digest(self, analysis):
        assert analysis["plan"]["primary_outcome"] == "crashed"
        assert analysis["plan_hash"] == digest(analysis["plan"])

    def test_the_first_plan_can_still_be_asked_for(self) -> None:
        first = plan_of(["standard"], version=1)
        assert first.family("two-way", "crash_free_time", "risky") is not None
        assert first.family("two-way", "crashed", "regular") is None
        second = plan_of(["standard"])
        assert second.family("two-way", "crashed", "risky") is not None
        assert second.family("two-way", "crashed", "regular") is not None
        assert first.looks == second.looks == TWO_BATCHES.looks

    @pytest.mark.parametrize("regular, status", [(1.0, "no information"), (0.0, "ok")])
    def test_a_setting_where_everybody_crashes_says_nothing(self, regular: float, status: str) -> None:
        values = np.stack([np.full((4, 30), regular), np.full((4, 30), 0.5)])
        arm = Arm(tuple(range(4)), ("a", "b", "c", "d"), {"crashed": values})
        place = ("sumo", "highway", 1, "50")
        records = effects({place: {"treatment": arm, "control": arm}}, outcomes=["crashed"])
        [found] = [r for r in records if r["term"] == "regular"]
        assert (found["status"], found["p"] is None) == (status, status != "ok")

    @pytest.mark.parametrize("plan", [DEFAULT, TWO_BATCHES])
    def test_what_a_family_tests_is_not_called_exploratory(self, plan: Plan) -> None:
        named = as_data(plan, {})["exploratory"]
        assert f"{plan.primary_outcome} {plan.primary_term}" not in named
        tested = [(o, t) for o in OUTCOMES for t in TERMS if any(plan.family(task, o, t) for task in TASKS)]
        assert tested
        assert [f"{o} {t}" for o, t in tested if f"{o} {t}" in named] == []

    def test_another_choice_is_another_digest(self):
        other = replace(DEFAULT, primary_term="sum")
        assert digest(as_data(other, {})) != digest(as_data(DEFAULT, {}))
        assert digest(as_data(DEFAULT, {"gate": "another"})) != digest(as_data(DEFAULT, {}))

    def test_in_the_first_plan_the_time_to_crash_is_primary_on_the_two_way_road(self):
        random = np.random.default_rng(0)
        for task, outcome in (("highway", "crashed"), ("two-way", "crash_free_time")):
            safety = [
                r for r in effects(agents(1, 3, random, task=task), plan=FIRST) if r["family"] == "safety"
            ]
            assert [(r["outcome"], r["term"]) for r in safety] == [(outcome, "risky")]


class TestEffects:
    def test_equals_the_formula_on_seed_means(self, results, analysis):
        """ATE = (T - C) in risky + (T - C) in regular; the scenarios are those of both traffics."""
        chosen = results.episodes.query("task == 'highway' and level == 1 and kind == 'agent'")
        wide = chosen.assign(crashed=chosen["crashed"].astype(float)).pivot_table(
            index=["arm", "seed"], columns=["traffic", "scenario"], values="crashed"
        )
        for term, values in {
            "risky": wide["risky"],
            "regular": wide["regular"],
            "sum": wide["risky"] + wide["regular"],
            "interaction": wide["risky"] - wide["regular"],
        }.items():
            arms = [(values.loc["treatment"].to_numpy(), 1.0), (values.loc["control"].to_numpy(), -1.0)]
            expected = interval(linear(arms))
            record = find(analysis["ate"], task="highway", level=1, outcome="crashed", term=term)
            assert record["estimate"] == pytest.approx(expected.estimate)
            assert record["seeds"] == [4, 4]
            assert record["status"] == "ok"
            assert len(record["cells"]) == 8
            if term == "regular":  # often enough crashed for no floor
                assert (record["low"], record["high"]) == pytest.approx((expected.low, expected.high))

    def test_every_place_outcome_and_term_is_there_once(self, analysis):
        keys = {(r["task"], r["level"], r["outcome"], r["term"]) for r in analysis["ate"]}
        assert len(keys) == len(analysis["ate"]) == 5 * len(OUTCOMES) * len(TERMS)

    def test_the_printed_formula_is_positive_without_any_effect(self):
        """Its last term is added: about twice the treated agents' mean, whatever the arms do."""
        record = find(effects(agents(1, 5, np.random.default_rng(3))), outcome="return", term="sum")
        assert abs(record["estimate"]) < 3
        assert record["literal"] == pytest.approx(record["mean_treatment"], abs=1)
        assert record["literal"] > 15
        assert record["percent"]["estimate"] == pytest.approx(record["estimate"] / record["mean_control"])

    def test_families_by_holm_and_the_rest_by_benjamini_hochberg(self, analysis):
        for outcome, term in (("return", "sum"), ("crashed", "risky")):
            record = find(analysis["ate"], task="u-turn", level=1, outcome=outcome, term=term)
            assert record["adjustment"] == "Holm over 5"
        for outcome, term in (("return", "risky"), ("mean_speed", "sum"), ("crashed", "sum")):
            record = find(analysis["ate"], task="u-turn", level=1, outcome=outcome, term=term)
            assert "Benjamini" in record["adjustment"]
        assert all(r["p_adjusted"] is None or r["p_adjusted"] >= r["p"] for r in analysis["ate"])

    def test_agents_that_do_not_vary_are_degenerate(self):
        """Six diverged agents that all drive the same: an effect of exactly 0 is no finding."""
        for record in effects(agents(1, 3, np.random.default_rng(0), spread=0.0), outcomes=["return"]):
            assert record["status"] == "degenerate"
            assert record["estimate"] == 0
            assert record["low"] is None and record["p"] is None and record["p_adjusted"] is None

    def test_crashes_per_distance_are_a_ratio_of_sums(self, results, analysis):
        rows = results.episodes.query(
            "task == 'highway' and level == 1 and arm == 'control' and traffic == 'risky'"
        )
        sums = rows.groupby("seed")[["crashed", "distance"]].sum()
        record = find(analysis["ate"], task="highway", level=1, outcome="crashes_per_100_km", term="risky")
        assert record["mean_control"] == pytest.approx((sums["crashed"] / sums["distance"] * 1e5).mean())

    def test_the_time_to_crash_is_at_most_the_episodes(self, results, analysis):
        rows = results.episodes.query(
            "task == 'highway' and level == 1 and arm == 'control' and traffic == 'risky'"
        )
        time = rows["crash_time"].astype(float).where(rows["crashed"], rows["length"])  # one step in a second
        record = find(analysis["ate"], task="highway", level=1, outcome="crash_free_time", term="risky")
        assert record["mean_control"] == pytest.approx(time.groupby(rows["seed"]).mean().mean())


class TestGates:
    @pytest.mark.parametrize(
        ("slug", "failed"),
        [
            ("sumo-highway-100-control-s0", "q_bounded"),
            ("sumo-highway-100-treatment-s2", "not_constant"),
            ("sumo-u-turn-3-control-s1", "not_constant"),
            ("sumo-u-turn-6-treatment-s3", "beats_constant"),
        ],
    )
    def test_each_catches_its_fault(self, analysis, slug, failed):
        (verdict,) = [v for v in analysis["gates"] if v["cell"].startswith(slug + "-")]
        assert verdict["passed"] is False
        assert failed in verdict["failed"]
        assert not verdict["gates"][failed]["passed"]

    def test_sound_agents_pass(self, analysis):
        sound = [v for v in analysis["gates"] if not any(v["cell"].startswith(slug + "-") for slug in FAULTS)]
        assert len(sound) == 36
        assert all(v["passed"] is True for v in sound)

    def test_values_and_limits_are_given(self, analysis):
        gates = analysis["gates"][0]["gates"]
        assert gates["q_bounded"]["limit"] == pytest.approx(1.2 * 1 / (1 - 0.95))
        assert gates["beats_constant"]["value"] > gates["beats_constant"]["limit"]
        assert "slower" in gates["beats_constant"]["note"]

    def test_agents_that_fail_are_named_and_counted(self, analysis):
        record = find(analysis["ate"], task="highway", level=2, outcome="crashed", term="sum")
        assert record["status"] == "ok"
        assert record["failed"] == [1, 1]
        assert "1 of 4 treatment agents fail (1 constant policy" in record["gates"]
        assert "1 of 4 control agents fail (1 diverged" in record["gates"]

    def test_q_that_is_no_longer_finite_fails(self, results):
        name = next(name for name, cell in results.cells.items() if cell["key"]["kind"] == "agent")
        cell = {**results.cells[name]}
        cell["learner"] = {**cell["learner"], "probe_q": [[1, 1.0, 2.0], [2, None, None]]}
        changed = analyse(replace(results, cells={**results.cells, name: cell}))
        verdict = find(changed["gates"], cell=name)
        assert verdict["gates"]["q_bounded"] == {
            "passed": False, "value": None, "limit": pytest.approx(24), "note": "Q-values are no longer finite",
        }  # fmt: skip

    def test_without_baselines_the_gate_is_open_and_said_so(self, results):
        episodes = results.episodes[results.episodes["kind"] == "agent"]
        cells = {name: cell for name, cell in results.cells.items() if cell["key"]["kind"] == "agent"}
        gate_episodes = results.gate_episodes[results.gate_episodes["kind"] == "agent"]
        changed = analyse(replace(results, episodes=episodes, gate_episodes=gate_episodes, cells=cells))
        record = find(changed["ate"], task="highway", level=1, outcome="crashed", term="sum")
        assert record["status"] == "ok"
        assert "not checked: not above a constant policy" in record["gates"]
        assert {v["passed"] for v in changed["gates"]} == {None, False}


class TestPooling:
    def test_every_task_weighs_the_same_over_all_agents(self, analysis):
        (mean,) = [r for r in analysis["pooled"] if r["primary"]]
        assert (mean["scope"], mean["outcome"], mean["term"]) == ("all tasks", "crashed", "risky")
        assert mean["comparisons"] == [5, 5]
        chosen = pd.DataFrame(
            [r for r in analysis["ate"] if (r["outcome"], r["term"]) == ("crashed", "risky")]
        )
        assert mean["estimate"] == pytest.approx(chosen.groupby("task")["estimate"].mean().mean())

    def test_returns_of_different_tasks_are_not_averaged(self, analysis):
        assert not [r for r in analysis["pooled"] if (r["scope"], r["outcome"]) == ("all tasks", "return")]

    def test_heterogeneity_over_settings_and_tasks(self, analysis):
        (mean,) = [r for r in analysis["pooled"] if r["primary"]]
        assert mean["over_settings"]["members"] == 5
        assert mean["over_settings"]["prediction"][0] < mean["over_settings"]["low"]
        assert mean["over_tasks"] is None  # two tasks are no sample of tasks

    def test_slope_finds_an_effect_that_grows(self):
        pairs = agents(4, 6, np.random.default_rng(2), spread=0.3, growth=0.5)
        found = slopes(pairs, {"highway": 4})
        record = find(found, outcome="return", quantity="effect")
        assert 0 < record["low"] < 1.0 < record["high"]
        assert record["complete"]
        mean = find(found, outcome="return", quantity="mean")
        assert mean["low"] < 0.25 < mean["high"]
        assert not find(slopes(pairs, {"highway": 5}), outcome="return", quantity="mean")["complete"]

    def test_the_share_of_agents_that_fail_is_an_outcome(self):
        pairs = agents(3, 6, np.random.default_rng(2))
        bad = [cell for pair in pairs.values() for cell in pair["treatment"].cells[:3]]
        record = find(failures(pairs, [verdict(cell, False, "treatment") for cell in bad]), scope="all tasks")
        assert record["counts"] == [[9, 18], [0, 18]]
        assert record["estimate"] == pytest.approx(0.5)
        assert 0 < record["low"] < 0.5 < record["high"]

    def test_no_failure_in_either_arm_has_an_interval(self):
        record = find(failures(agents(1, 5, np.random.default_rng(2)), []), scope="all tasks")
        assert record["estimate"] == 0
        assert 0.1 < record["high"] < 0.6


class TestSensitivity:
    def test_without_those_that_fail(self):
        pairs = agents(2, 5, np.random.default_rng(3), spread=0.1)
        bad = [verdict(cell, False, "treatment") for p in pairs.values() for cell in p["treatment"].cells[:1]]
        found = {r["variant"]: r for r in sensitivity(pairs, bad)}
        assert found["all agents, tasks alike (primary)"]["seeds"] == [10, 10]
        assert found["agents that pass the gates"]["seeds"] == [8, 10]
        assert found["agents paired by training seed"]["seeds"] == [10]

    def test_all_variants_agree_on_a_clear_effect(self, analysis):
        assert len(analysis["sensitivity"]) == 8 + len({record["task"] for record in analysis["ate"]})
        for record in analysis["sensitivity"]:
            assert record["estimate"] < 0
            assert record["p"] < 0.05

    def test_each_task_is_left_out_once(self):
        random = np.random.default_rng(3)
        highway = agents(2, 5, random, spread=0.1)
        found = {
            r["variant"]: r for r in sensitivity(highway | agents(2, 5, random, effect=3.0, task="u-turn"))
        }
        assert found["without u-turn"]["settings"] == found["without highway"]["settings"] == [2, 4]
        assert found["without u-turn"]["estimate"] == pytest.approx(0, abs=0.3)
        assert found["without highway"]["estimate"] == pytest.approx(3, abs=1.5)
        assert not any("without" in record["variant"] for record in sensitivity(highway))

    def test_the_permutation_is_exact_for_a_complete_separation(self):
        pairs = agents(1, 4, np.random.default_rng(3), spread=0.01, effect=5.0)
        record = find(sensitivity(pairs), variant="permutation of the arms")
        assert record["p"] == pytest.approx(2 / 70, abs=0.012)

    def test_a_setting_is_learnt_if_its_control_agents_are(self):
        pairs = agents(2, 4, np.random.default_rng(3))
        first, second = pairs.values()
        verdicts = [verdict(cell, False, "treatment") for cell in first["treatment"].cells]
        verdicts += [verdict(cell, True, "control") for cell in first["control"].cells]
        verdicts += [verdict(cell, k == 0, "control") for k, cell in enumerate(second["control"].cells)]
        assert [r["learnt"] for r in learnt(pairs, verdicts)] == [True, False]


class TestSecondBatch:
    def test_goes_where_it_is_open_and_ten_seeds_can_decide(self):
        pairs = {
            **agents(1, 5, np.random.default_rng(3), spread=0.02, effect=1.0, task="highway"),  # decided
            **agents(1, 5, np.random.default_rng(4), spread=0.02, effect=0.0, task="u-turn"),  # open
            **agents(1, 5, np.random.default_rng(5), spread=0.5, effect=0.1, task="roundabout"),  # hopeless
        }
        records = effects(pairs, plan=TWO_BATCHES)
        found = {r["task"]: (r["extend"], r["reason"]) for r in second_batch(pairs, records, TWO_BATCHES)}
        assert found["highway"] == (False, "decided")
        assert found["u-turn"][0]
        assert found["roundabout"] == (False, "10 seeds would not decide it")
        assert second_batch(pairs, records, DEFAULT) == []

    def test_the_first_look_has_a_fifth_of_the_error_rate(self):
        pairs = agents(1, 5, np.random.default_rng(3), effect=1.0)
        one_look, first = (
            find(effects(pairs, plan=plan), outcome="return", term="sum")["p"]
            for plan in (DEFAULT, TWO_BATCHES)
        )
        assert first == pytest.approx(min(1.0, 5 * one_look))

    def test_both_looks_count_when_all_seeds_are_there(self):
        pairs = agents(1, 10, np.random.default_rng(3), effect=1.0)
        place, pair = next(iter(pairs.items()))
        early = {place: {name: arm.below(5) for name, arm in pair.items()}}
        p = [find(effects(x), outcome="return", term="sum")["p"] for x in (early, pairs)]
        both = find(effects(pairs, plan=TWO_BATCHES), outcome="return", term="sum")["p"]
        assert both == pytest.approx(min(p[0] / 0.2, p[1] / 0.8, 1.0))


class TestClaims:
    @staticmethod
    def records(*values, status="ok"):
        """Records with estimate, p and Holm's p."""
        p = [p for _, p in values]
        return [
            {"task": "highway", "level_name": str(k), "outcome": "return", "estimate": e, "low": e - 1, "high": e + 1,
             "p": p[k], "p_adjusted": min(1, p[k] * len(p)), "status": status, "cells": []}
            for k, (e, _) in enumerate(values)
        ]  # fmt: skip

    def test_holds_if_each_does_by_itself(self):
        """Everywhere at once is the harder claim: it needs no adjustment for the number of places."""
        assert decide(self.records((1, 0.01), (2, 0.04)), +1, 2)[0] == "holds"
        assert decide(self.records((-1, 0.01), (-2, 0.04)), -1, 2)[0] == "holds"
        assert decide(self.records((1, 0.01), (2, 0.06)), +1, 2)[0] == "not decided"

    def test_contradicted_only_after_adjustment(self):
        assert decide(self.records((1, 0.01), (-2, 0.04)), +1, 2)[0] == "not decided"

    def test_places_that_were_not_run_keep_it_open(self):
        verdict, reason, counts = decide(self.records((1, 0.01), (2, 0.01)), +1, 18)
        assert verdict == "not decided"
        assert "as claimed in 2 of 18" in reason and "16 not run" in reason
        assert counts["right"] == 2 and counts["not_run"] == 16

    def test_is_graded(self):
        """Weak evidence in many places: in no single one, but together in some at least."""
        _, _, counts = decide(self.records(*[(1.0, 0.02)] * 6), +1, 6)
        assert counts["right"] == 0 and counts["at_least"] >= 4
        assert counts["wrong_at_least"] == 0

    def test_one_on_the_other_side_contradicts_and_is_named(self):
        verdict, reason, _ = decide(self.records((1, 0.01), (-2, 0.01)), +1, 2)
        assert verdict == "contradicted"
        assert "highway 1 (−2.00 [−3.00, −1.00])" in reason

    @pytest.mark.parametrize("status", ["degenerate", "no interval: one seed"])
    def test_what_is_no_evidence_counts_neither_way(self, status):
        wrong = self.records((-2, 0.01), status=status)
        assert decide(self.records((1, 0.01)) + wrong, +1, 2)[0] == "not decided"
        verdict, reason, _ = decide(wrong, +1, 1)
        assert verdict == "not decided"
        assert "no evidence from 1" in reason

    @pytest.mark.parametrize(
        ("estimate", "verdict"), [(0.001, "holds"), (0.05, "not decided"), (0.2, "contradicted")]
    )
    def test_no_harm_is_an_equivalence(self, estimate, verdict):
        record = {
            "task": "highway", "level_name": "50", "outcome": "crashed", "estimate": estimate, "se": 0.01, "df": 8.0,
            "low": estimate - 0.023, "high": estimate + 0.023, "margin": 0.05, "status": "ok", "cells": [],
        }  # fmt: skip
        p = float(stats.t.sf((0.05 - estimate) / 0.01, 8))
        record |= {"equivalence_p": p, "equivalence_p_adjusted": p}
        assert decide_equivalence([record], 1)[0] == verdict

    def test_what_would_decide_it_is_said(self, analysis):
        for claim in analysis["claims"]:
            assert (claim["decides"] is None) == (claim["verdict"] != "not decided")
        safety = find(analysis["claims"], outcome="primary")
        assert "13 settings that were not run" in safety["decides"]

    def test_all_seven_for_each_simulator(self, analysis):
        assert len(analysis["claims"]) == 7
        assert {claim["source"] for claim in analysis["claims"]} == {"paper", "crash rate"}
        assert all(claim["cells"] for claim in analysis["claims"])

    def test_signs_are_those_of_the_claims(self):
        """An effect that raises return and crash rate, both of which rise with traffic."""
        pairs = agents(3, 8, np.random.default_rng(6), spread=0.1, effect=3.0)
        for (_, _, level, _), pair in pairs.items():
            for arm in pair.values():
                arm.values["return"][...] += level  # every outcome shares these scores
        found = claims(effects(pairs), slopes(pairs, {"highway": 3}), {"highway": 3})
        verdicts = {(claim["source"], claim["claim"].split()[0]): claim["verdict"] for claim in found}
        assert verdicts["paper", "Training"] == "holds"
        assert verdicts["paper", "The"] == "contradicted"
        assert verdicts["crash rate", "Training"] == "contradicted"
        assert verdicts["crash rate", "The"] == "holds"
        assert verdicts["crash rate", "It"] == "contradicted"


class TestHeadline:
    def test_says_safer_with_numbers_and_the_mark_to_beat(self, analysis):
        (headline,) = analysis["headlines"]
        assert headline["answer"] == "safer"
        text = " ".join(headline["text"])
        for words in (
            "points [",
            "This averages 5 of 18 settings",
            "2 of 20 treated and 2 of 20 control agents fail the gates",
            "mark to beat",
            "every task weighted alike",
        ):
            assert words in text
        assert headline["cells"]

    def test_says_less_safe(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=4, tests=60, effect=+0.4, spread=0.01)
        (headline,) = analyse(load(tmp_path))["headlines"]
        assert headline["answer"] == "less safe"

    def test_one_seed_is_no_answer(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=1)
        found = analyse(load(tmp_path))
        assert found["headlines"][0]["answer"] == "no answer"
        assert "single training seed" in found["headlines"][0]["text"][0]
        record = find(found["ate"], outcome="crashed", term="sum")
        assert record["status"] == "no interval: one seed"
        assert record["estimate"] is not None and record["low"] is None
        assert {claim["verdict"] for claim in found["claims"]} == {"not decided"}

    def test_one_arm_is_no_answer(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, arms=("control",))
        found = analyse(load(tmp_path))
        assert found["headlines"][0]["answer"] == "no answer"
        assert {r["status"] for r in found["ate"]} == {"missing"}
        assert len(found["missing"]) == 2


class TestSettingsAreNotMixed:
    def test_the_last_sweep_decides(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, updates=200, baselines=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, updates=400)
        chosen, left_out = comparable(load(tmp_path))
        assert len(left_out) == 6
        assert all("updates 200 instead of 400" in entry["reason"] for entry in left_out)
        assert set(chosen.agents["updates"].dropna()) == {400}
        assert set(chosen.episodes["cell"]) == set(chosen.cells)
        assert analyse(load(tmp_path))["ate"][0]["seeds"] == [2, 2]

    def test_baselines_of_another_test_are_left_out(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=10, arms=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=20, baselines=())
        found = analyse(load(tmp_path))
        assert len(found["left_out"]) == len(BASELINES)
        assert "episodes 10 instead of 20" in found["left_out"][0]["reason"]

    def test_presets_are_labels(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, preset="quick")
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, preset="paper")
        found = analyse(load(tmp_path))
        assert found["left_out"] == []
        assert found["ate"][0]["seeds"] == [3, 3]
        assert found["provenance"]["presets"] == ["paper", "quick"]


class TestAnalysis:
    def test_is_strict_json(self, analysis):
        assert json.loads(json.dumps(analysis, allow_nan=False)) == analysis

    def test_is_a_pure_function(self, results, analysis):
        shuffled = replace(
            results,
            cells=dict(reversed(results.cells.items())),
            episodes=results.episodes.sample(frac=1, random_state=1).reset_index(drop=True),
        )
        assert json.dumps(analyse(results)) == json.dumps(analysis)
        assert analyse(shuffled)["headlines"] == analysis["headlines"]
        assert analyse(shuffled)["provenance"]["hash"] == analysis["provenance"]["hash"]

    def test_policies_are_means_of_seeds_and_of_episodes(self, results, analysis):
        episodes = results.episodes.query("task == 'highway' and level == 1 and traffic == 'risky'")
        arm = find(analysis["policies"], task="highway", level=1, arm="control", traffic="risky")
        means = episodes[episodes["arm"] == "control"].groupby("seed")["return"].mean()
        assert arm["mean"]["return"] == pytest.approx(means.mean())
        assert arm["se"]["return"] == pytest.approx(means.sem())
        assert (arm["n"], arm["unit"]) == (4, "training seed")
        careful = find(analysis["policies"], task="highway", level=1, policy="careful", traffic="risky")
        returns = episodes.loc[episodes["policy"] == "careful", "return"]
        assert careful["mean"]["return"] == pytest.approx(returns.mean())
        assert careful["se"]["return"] == pytest.approx(returns.sem())
        assert (careful["n"], careful["unit"]) == (20, "test episode")

    def test_summary_has_one_row_a_policy_and_traffic(self, analysis):
        table = summary_table(analysis)
        keys = ["backend", "task", "level", "policy", "arm", "traffic"]
        assert len(table) == 5 * (2 + len(BASELINES)) * 2 == len(table.drop_duplicates(keys))
        assert {"crashed", "crashed_se", "density", "cells"} <= set(table.columns)

    def test_two_simulators_are_kept_apart(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2)
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, backend="highway-env")
        found = analyse(load(tmp_path))
        assert {(r["backend"], *r["seeds"]) for r in found["ate"]} == {("sumo", 2, 2), ("highway-env", 3, 3)}
        assert [h["backend"] for h in found["headlines"]] == ["highway-env", "sumo"]
        assert len(found["claims"]) == 14
