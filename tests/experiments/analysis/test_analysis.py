"""From stored cells to effects, gates, verdicts: the numbers, their status, and their error rates."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.analysis import analyse, summary_table
from experiments.analysis.effects import effects, placebo
from experiments.analysis.pooling import slopes
from experiments.analysis.statistics import welch
from experiments.analysis.tables import OUTCOMES, TERMS, comparable, units
from experiments.analysis.verdicts import claims, decide
from experiments.study import store
from experiments.study.grid import BASELINES
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
    return store.load(directory)


@pytest.fixture(scope="module")
def analysis(results):
    return analyse(results)


def find(records, **wanted):
    """The one record with these fields."""
    (found,) = [r for r in records if all(r[key] == value for key, value in wanted.items())]
    return found


def agents(levels, seeds, random, effect=0.0, spread=1.0, outcome="return"):
    """A table as `tables.units` makes it, of one task with many levels; every outcome is normally distributed."""
    rows = []
    for level in range(1, levels + 1):
        for arm in ("control", "treatment"):
            for seed in range(seeds):
                row = {"cell": f"{level}-{arm}-{seed}", "kind": "agent", "backend": "sumo", "task": "highway"}
                row |= {"level": level, "level_name": str(level), "arm": arm, "seed": seed, "policy": "dqn"}
                own = random.normal(0, spread)
                for traffic in ("regular", "risky"):
                    value = 10 + own + random.normal(0, 0.3) + effect * (arm == "treatment")
                    row |= {f"{name} {traffic}": value for name in OUTCOMES}
                rows.append(row)
    return pd.DataFrame(rows)


class TestEffects:
    def test_equals_the_formula_on_seed_means(self, results, analysis):
        """ATE = (T - C) in risky + (T - C) in regular, from one number an agent."""
        chosen = results.episodes.query("task == 'highway' and level == 1 and kind == 'agent'")
        means = chosen.groupby(["arm", "seed", "traffic"])["crashed"].mean().unstack("traffic")
        for term, values in {
            "risky": means["risky"],
            "regular": means["regular"],
            "sum": means["risky"] + means["regular"],
            "interaction": means["risky"] - means["regular"],
        }.items():
            expected = welch(values["treatment"], values["control"])
            record = find(analysis["ate"], task="highway", level=1, outcome="crashed", term=term)
            assert record["estimate"] == pytest.approx(expected.estimate)
            assert (record["low"], record["high"]) == pytest.approx((expected.low, expected.high))
            assert record["seeds"] == [4, 4]
            assert record["status"] == "ok"
            assert len(record["cells"]) == 8

    def test_every_place_outcome_and_term_is_there_once(self, analysis):
        keys = {(r["task"], r["level"], r["outcome"], r["term"]) for r in analysis["ate"]}
        assert len(keys) == len(analysis["ate"]) == 5 * len(OUTCOMES) * len(TERMS)

    def test_the_printed_formula_is_positive_without_any_effect(self):
        """Its last term is added: about twice the treated agents' mean, whatever the arms do."""
        table = agents(levels=1, seeds=5, random=np.random.default_rng(3))
        record = find(effects(table), outcome="return", term="sum")
        assert abs(record["estimate"]) < 3
        assert record["literal"] == pytest.approx(record["mean_treatment"], abs=1)
        assert record["literal"] > 15
        assert record["percent"]["estimate"] == pytest.approx(record["estimate"] / record["mean_control"])

    @pytest.mark.parametrize("term", ["sum", "interaction"])
    def test_false_positives_are_five_percent_from_table_to_verdict(self, term):
        repeats = 400
        table = agents(levels=repeats, seeds=5, random=np.random.default_rng(11))
        records = effects(table, outcomes=["mean_speed"], terms=[term])
        rejected = sum(r["p"] < 0.05 for r in records) / repeats
        assert abs(rejected - 0.05) < 4 * np.sqrt(0.05 * 0.95 / repeats)

    def test_holm_for_the_confirmatory_and_benjamini_hochberg_for_the_rest(self, analysis):
        assert (
            find(analysis["ate"], task="u-turn", level=1, outcome="return", term="sum")["adjustment"]
            == "Holm over 5"
        )
        assert (
            "Benjamini"
            in find(analysis["ate"], task="u-turn", level=1, outcome="return", term="risky")["adjustment"]
        )
        assert (
            "Benjamini"
            in find(analysis["ate"], task="u-turn", level=1, outcome="mean_speed", term="sum")["adjustment"]
        )
        assert all(r["p_adjusted"] is None or r["p_adjusted"] >= r["p"] for r in analysis["ate"])

    def test_arms_that_do_not_vary_are_degenerate(self):
        """Six diverged agents that all drive the same: an effect of exactly 0 is no finding."""
        table = agents(levels=1, seeds=3, random=np.random.default_rng(0), spread=0.0)
        for column in [f"{name} {traffic}" for name in OUTCOMES for traffic in ("regular", "risky")]:
            table[column] = 13.84
        for record in effects(table):
            assert record["status"] == "degenerate"
            assert record["estimate"] == 0
            assert record["low"] is None and record["p"] is None and record["p_adjusted"] is None

    def test_equivalence_is_tested_in_each_traffic(self):
        random = np.random.default_rng(5)
        record = find(effects(agents(1, 10, random, spread=0.01), outcomes=["crashed"]), term="regular")
        assert record["margin"] == 0.05
        assert 0 <= record["equivalence_p"] <= 1


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

    def test_an_agent_that_fails_makes_its_effects_uninformative_but_keeps_the_number(self, analysis):
        record = find(analysis["ate"], task="highway", level=2, outcome="crashed", term="sum")
        assert record["status"] == "uninformative"
        assert "1 of 4 treatment agents fail (1 constant policy" in record["reason"]
        assert "1 of 4 control agents fail (1 diverged" in record["reason"]
        assert record["estimate"] is not None and record["low"] is not None

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
        assert "not checked: not above a constant policy" in record["reason"]
        assert {v["passed"] for v in changed["gates"]} == {None, False}


class TestPooling:
    def test_mean_over_levels_leaves_out_what_failed(self, analysis):
        every = find(analysis["pooled"], scope="all tasks", outcome="crashed", term="risky", selection="all")
        sound = find(
            analysis["pooled"], scope="all tasks", outcome="crashed", term="risky", selection="informative"
        )
        assert every["comparisons"] == [5, 5]
        assert sound["comparisons"] == [2, 5]
        chosen = [
            r for r in analysis["ate"] if (r["outcome"], r["term"], r["status"]) == ("crashed", "risky", "ok")
        ]
        assert sound["estimate"] == pytest.approx(np.mean([r["estimate"] for r in chosen]))

    def test_returns_of_different_tasks_are_not_averaged(self, analysis):
        assert not [r for r in analysis["pooled"] if (r["scope"], r["outcome"]) == ("all tasks", "return")]

    def test_slope_finds_an_effect_that_grows(self):
        random = np.random.default_rng(2)
        table = agents(levels=4, seeds=6, random=random, spread=0.3)
        treated = table["arm"] == "treatment"
        for traffic in ("regular", "risky"):
            table.loc[treated, f"return {traffic}"] += 0.5 * table.loc[treated, "level"]
        record = find(slopes(table, effects(table)), outcome="return", quantity="effect")
        assert record["low"] < 1.0 < record["high"]
        assert record["low"] > 0
        mean = find(slopes(table, effects(table)), outcome="return", quantity="mean")
        assert mean["low"] < 0.25 < mean["high"]

    def test_an_uninformative_level_makes_the_slope_so(self, analysis):
        record = find(analysis["slopes"], task="u-turn", outcome="crashed", quantity="effect")
        assert record["status"] == "uninformative"
        assert "3, 6" in record["reason"]


class TestPlacebo:
    def test_control_against_control_rejects_about_five_percent(self):
        table = agents(levels=200, seeds=8, random=np.random.default_rng(4), effect=5.0)
        for record in placebo(table):
            assert record["comparisons"] == 200
            assert abs(record["rejected"] / 200 - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 200)
            assert record["p"] > 1e-4

    def test_needs_four_control_agents(self):
        assert placebo(agents(levels=3, seeds=3, random=np.random.default_rng(4))) == []


class TestClaims:
    @staticmethod
    def records(*values, status="ok"):
        """Records with estimate and adjusted p."""
        return [
            {"task": "highway", "level_name": str(k), "estimate": e, "low": e - 1, "high": e + 1, "p_adjusted": p,
             "status": status, "cells": []}
            for k, (e, p) in enumerate(values)
        ]  # fmt: skip

    def test_holds_only_if_all_do(self):
        assert decide(self.records((1, 0.01), (2, 0.04)), +1, 2, "return")[0] == "holds"
        assert decide(self.records((-1, 0.01), (-2, 0.04)), -1, 2, "return")[0] == "holds"
        assert decide(self.records((1, 0.01), (2, 0.06)), +1, 2, "return")[0] == "not decided"

    def test_places_that_were_not_run_keep_it_open(self):
        verdict, reason = decide(self.records((1, 0.01), (2, 0.01)), +1, 18, "return")
        assert verdict == "not decided"
        assert "as claimed in 2 of 18" in reason and "16 not run" in reason

    def test_one_on_the_other_side_contradicts_and_is_named(self):
        verdict, reason = decide(self.records((1, 0.01), (-2, 0.01)), +1, 2, "return")
        assert verdict == "contradicted"
        assert "highway 1 (−2.00 [−3.00, −1.00])" in reason

    @pytest.mark.parametrize("status", ["uninformative", "degenerate", "no interval: one seed"])
    def test_what_is_no_evidence_counts_neither_way(self, status):
        wrong = self.records((-2, 0.01), status=status)
        assert decide(self.records((1, 0.01)) + wrong, +1, 2, "return")[0] == "not decided"
        verdict, reason = decide(wrong, +1, 1, "return")
        assert verdict == "not decided"
        assert "no evidence from 1" in reason

    def test_all_six_for_each_simulator(self, analysis):
        assert len(analysis["claims"]) == 6
        assert {claim["source"] for claim in analysis["claims"]} == {"paper", "crash rate"}
        assert all(claim["cells"] for claim in analysis["claims"])

    def test_signs_are_those_of_the_claims(self):
        """Return and crash rate that rise with traffic, and an effect that raises both."""
        table = agents(levels=3, seeds=8, random=np.random.default_rng(6), spread=0.1, effect=3.0)
        for name in OUTCOMES:
            for traffic in ("regular", "risky"):
                table[f"{name} {traffic}"] += table["level"]
        records = effects(table)
        found = claims(records, slopes(table, records), {"highway": 3})
        verdicts = {(claim["source"], claim["claim"].split()[0]): claim["verdict"] for claim in found}
        assert verdicts["paper", "Training"] == "holds"
        assert verdicts["paper", "The"] == "contradicted"
        assert verdicts["crash rate", "Training"] == "contradicted"
        assert verdicts["crash rate", "The"] == "holds"


class TestHeadline:
    def test_says_safer_with_numbers_and_the_mark_to_beat(self, analysis):
        (headline,) = analysis["headlines"]
        assert headline["answer"] == "safer"
        text = " ".join(headline["text"])
        for words in (
            "points [",
            "2 of 5 comparisons",
            "agents that fail the gates",
            "mark to beat",
            "exploratory",
        ):
            assert words in text
        assert headline["cells"]

    def test_says_less_safe(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=4, tests=60, effect=+0.4, spread=0.01)
        (headline,) = analyse(store.load(tmp_path))["headlines"]
        assert headline["answer"] == "less safe"

    def test_one_seed_is_no_answer(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=1)
        found = analyse(store.load(tmp_path))
        assert found["headlines"][0]["answer"] == "no answer"
        assert "single training seed" in found["headlines"][0]["text"][0]
        record = find(found["ate"], outcome="crashed", term="sum")
        assert record["status"] == "no interval: one seed"
        assert record["estimate"] is not None and record["low"] is None
        assert {claim["verdict"] for claim in found["claims"]} == {"not decided"}

    def test_one_arm_is_no_answer(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, arms=("control",))
        found = analyse(store.load(tmp_path))
        assert found["headlines"][0]["answer"] == "no answer"
        assert {r["status"] for r in found["ate"]} == {"missing"}
        assert len(found["missing"]) == 2


class TestSettingsAreNotMixed:
    def test_the_last_sweep_decides(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, updates=200, baselines=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, updates=400)
        chosen, left_out = comparable(store.load(tmp_path))
        assert len(left_out) == 6
        assert all("updates 200 instead of 400" in entry["reason"] for entry in left_out)
        assert set(chosen.agents["updates"].dropna()) == {400}
        assert set(chosen.episodes["cell"]) == set(chosen.cells)
        assert analyse(store.load(tmp_path))["ate"][0]["seeds"] == [2, 2]

    def test_baselines_of_another_test_are_left_out(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=10, arms=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=20, baselines=())
        found = analyse(store.load(tmp_path))
        assert len(found["left_out"]) == len(BASELINES)
        assert "episodes 10 instead of 20" in found["left_out"][0]["reason"]

    def test_presets_are_labels(self, tmp_path):
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, preset="quick")
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, preset="paper")
        found = analyse(store.load(tmp_path))
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
        found = analyse(store.load(tmp_path))
        assert {(r["backend"], *r["seeds"]) for r in found["ate"]} == {("sumo", 2, 2), ("highway-env", 3, 3)}
        assert [h["backend"] for h in found["headlines"]] == ["highway-env", "sumo"]
        assert len(found["claims"]) == 12

    def test_units_leave_out_cells_without_one_of_the_traffics(self, results):
        name = results.agents["cell"].iloc[0]
        cut = results.episodes[(results.episodes["cell"] != name) | (results.episodes["traffic"] == "risky")]
        assert name not in set(units(cut)["cell"])
        assert len(units(cut)) == len(results.cells) - 1
