"""The analysis of cells, and of scores, that are made up and whose truth is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.claims import claims
from experiments.analysis.comparable import comparable
from experiments.analysis.effects import WORKING_COLUMNS, contrasts, means, slopes
from experiments.analysis.estimate import interval, linear
from experiments.analysis.gates import THRESHOLDS
from experiments.analysis.plan import OUTCOMES, STUDY, Outcome, as_data
from experiments.study.design.sheet import SHEETS
from experiments.study.results.loaded import Results, load
from tests.experiments import synthetic
from tests.experiments.analysis.made_up import PAIR, agents, effects, find


class TestPlan:
    def test_its_digest_is_of_what_decides(self, monkeypatch: pytest.MonkeyPatch) -> None:
        plan = STUDY
        before = as_data(plan, THRESHOLDS)
        monkeypatch.setitem(OUTCOMES, "return", replace(OUTCOMES["return"], label="Sum of rewards", digits=4))
        monkeypatch.setitem(OUTCOMES, "waiting", Outcome("Waiting", "s", -1, 1, of=len))
        monkeypatch.setitem(SHEETS, "on-ramp", SHEETS["highway"])
        assert as_data(plan, THRESHOLDS) == before
        monkeypatch.setitem(OUTCOMES, "crashed", replace(OUTCOMES["crashed"], margin=0.04))
        others = [as_data(plan, THRESHOLDS), as_data(replace(plan, settings=plan.settings[1:]), THRESHOLDS)]
        assert before not in others

    def test_other_settings_decide_nothing(self) -> None:
        """Agents of a task that the plan does not name, with a large effect, beside those that it names."""
        random = np.random.default_rng(3)
        named = agents(3, 5, random, effect=-3.0)
        more = dict(
            zip([("sumo", "on-ramp", 1, "3")], agents(1, 5, random, effect=9.0).values(), strict=True)
        )
        few, many = effects(named), effects({**named, **more})
        assert set(many.loc[many["task"] == "on-ramp", "family"]) == {""}
        planned = many[many["task"] != "on-ramp"].reset_index(drop=True)
        tested = few["family"] != ""
        pd.testing.assert_frame_equal(planned[tested], few[tested])
        trends = slopes(named)
        counts = claims(few, trends).drop(columns="detectable")
        pd.testing.assert_frame_equal(
            claims(many, slopes({**named, **more})).drop(columns="detectable"), counts
        )
        assert set(counts["expected"]) == {5, 18}


@pytest.mark.parametrize(("effect", "side"), [(3.0, "better"), (-3.0, "worse"), (0.0, "open")])
def test_the_side_of_a_mean_is_decided_in_its_frame(effect: float, side: str) -> None:
    """For the return more is better, for the speed neither."""
    arms = agents(3, 5, np.random.default_rng(3), effect=effect, spread=0.5)
    found = means(contrasts(arms, {PAIR: [("return", "risky"), ("mean_speed", "risky")]}))
    assert set(found.loc[found["outcome"] == "return", "side"]) == {side}
    assert set(found.loc[found["outcome"] == "mean_speed", "side"]) == {""}
    assert means(contrasts({}, {PAIR: [("return", "risky")]})).empty


class TestEffects:
    def test_equals_the_formula_on_seed_means(self, results: Results, analysis: Analysis) -> None:
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
            row = find(analysis.effects, task="highway", level=1, outcome="crashed", term=term)
            assert row["estimate"] == pytest.approx(expected.estimate)
            assert (row["seeds_arm"], row["seeds_against"], row["status"]) == (4, 4, "ok")
            if term == "regular":  # often enough crashed for no floor
                assert (row["low"], row["high"]) == pytest.approx((expected.low, expected.high))

    def test_the_interval_at_the_familys_level_excludes_zero_only_where_holm_rejects(self, analysis) -> None:
        rows = analysis.effects[analysis.effects["low_family"].notna()]
        excluded = (rows["low_family"] > 0) | (rows["high_family"] < 0)
        assert len(rows) and (rows.loc[excluded, "p_adjusted"] < 0.05).all()

    def test_the_detectable_effect_is_the_one_at_the_level_that_decides(self, analysis: Analysis) -> None:
        rows = analysis.effects[analysis.effects["detectable"].notna()]
        for row in rows.itertuples():
            limit = stats.t.ppf(1 - 0.05 / 5 / 2, row.df)
            assert stats.nct.sf(limit, row.df, row.detectable / row.se) == pytest.approx(0.8, abs=1e-6)

    def test_agents_that_do_not_vary_are_degenerate(self) -> None:
        """Six diverged agents that all drive the same: an effect of exactly 0 is no finding."""
        rows = effects(agents(1, 3, np.random.default_rng(0), spread=0.0)).query("outcome == 'return'")
        assert set(rows["status"]) == {"degenerate"} and set(rows["estimate"]) == {0.0}
        assert rows[["low", "p", "p_adjusted"]].isna().all(axis=None)

    @pytest.mark.parametrize(("regular", "status"), [(1.0, "no information"), (0.0, "ok")])
    def test_a_setting_where_everybody_crashes_says_nothing(self, regular: float, status: str) -> None:
        values = np.stack([np.full((4, 30), regular), np.full((4, 30), 0.5)])
        arm = dict.fromkeys(OUTCOMES, values)
        rows = effects({("sumo", "highway", 1, "50"): {"treatment": arm, "control": arm}})
        found = find(rows, outcome="crashed", term="regular")
        assert (found["status"], bool(np.isnan(found["p"]))) == (status, status != "ok")

    def test_the_time_to_a_crash_is_at_most_the_episodes(self, results: Results, analysis: Analysis) -> None:
        rows = results.episodes.query(
            "task == 'highway' and level == 1 and arm == 'control' and traffic == 'risky'"
        )
        time = rows["crash_time"].astype(float).where(rows["crashed"], rows["length"])  # one step in a second
        row = find(analysis.effects, task="highway", level=1, term="risky", outcome="crash_free_time")
        assert row["mean_against"] == pytest.approx(time.groupby(rows["seed"]).mean().mean())


class TestMeans:
    def test_the_careful_driver_is_compared_scenario_by_scenario(self, results, analysis) -> None:
        rows = results.episodes.query("task == 'highway' and level == 1 and traffic == 'risky'")
        crashed = rows["crashed"].astype(float)
        careful = crashed[rows["policy"] == "careful"].mean()
        for arm in ("control", "treatment"):
            wanted = {"arm": arm, "against": "careful", "outcome": "crashed", "term": "risky"}
            row = find(analysis.effects, task="highway", level=1, **wanted)
            assert row["estimate"] == pytest.approx(crashed[rows["arm"] == arm].mean() - careful)
            assert row["low"] < row["estimate"] < row["high"]


class TestSlopes:
    def test_finds_an_effect_that_grows(self) -> None:
        arms = agents(3, 8, np.random.default_rng(4), spread=0.1, growth=1.0)
        row = find(slopes(arms), outcome="return", quantity="effect")
        assert row["estimate"] == pytest.approx(2.0, abs=0.2)  # in both traffics
        assert row["low"] > 0 and row["complete"]
        means = [np.mean([arm["return"] for arm in pair.values()]) for pair in arms.values()]
        level = find(slopes(arms), outcome="return", quantity="mean")
        assert level["estimate"] == pytest.approx(np.polyfit([1, 2, 3], means, 1)[0])

    def test_over_some_of_the_levels_decides_nothing(self) -> None:
        found = slopes(agents(2, 8, np.random.default_rng(4), spread=0.1, growth=3.0))
        assert not found["complete"].any()
        verdicts = claims(effects(agents(2, 8, np.random.default_rng(4))), found)
        row = find(verdicts, name="return effect grows")
        assert (row["verdict"], row["silent"], row["right"]) == ("not decided", 1, 0)


class TestAnalysis:
    def test_is_a_pure_function(self, results: Results, analysis: Analysis) -> None:
        shuffled = replace(
            results,
            cells=dict(reversed(results.cells.items())),
            episodes=results.episodes.sample(frac=1, random_state=1).reset_index(drop=True),
        )
        again = analyse(shuffled)
        for name in ("effects", "means", "claims", "gates", "policies"):
            own, other = (
                getattr(a, name).drop(columns=WORKING_COLUMNS, errors="ignore") for a in (analysis, again)
            )
            pd.testing.assert_frame_equal(own, other, rtol=1e-9)

    def test_policies_are_means_of_seeds_and_of_episodes(self, results: Results, analysis: Analysis) -> None:
        episodes = results.episodes.query("task == 'highway' and level == 1 and traffic == 'risky'")
        arm = find(analysis.policies, task="highway", level=1, arm="control", traffic="risky")
        by_seed = episodes[episodes["arm"] == "control"].groupby("seed")["return"].mean()
        assert (arm["return"], arm["return se"]) == pytest.approx((by_seed.mean(), by_seed.sem()))
        assert (arm["n"], arm["unit"]) == (4, "training seed")
        careful = find(analysis.policies, task="highway", level=1, policy="careful", traffic="risky")
        returns = episodes.loc[episodes["policy"] == "careful", "return"]
        assert (careful["return"], careful["return se"]) == pytest.approx((returns.mean(), returns.sem()))
        assert (careful["n"], careful["unit"]) == (20, "test episode")
        distance = episodes.loc[episodes["policy"] == "careful", "distance"]
        [config] = [c["key"]["env_config"] for n, c in results.cells.items() if "highway-50-careful" in n]
        assert careful["progress"] == pytest.approx(distance.mean() / config["duration"])

    def test_two_simulators_are_kept_apart(self, tmp_path: Any) -> None:
        few: dict[str, Any] = {"tests": 4, "baselines": ()}
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, **few)
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, backend="highway-env", **few)
        found = analyse(load(tmp_path))
        rows = (
            found.effects[["backend", "seeds_arm", "seeds_against"]]
            .query("seeds_against > 1")
            .drop_duplicates()
        )
        assert {tuple(row) for row in rows.to_numpy()} == {("sumo", 2, 2), ("highway-env", 3, 3)}
        assert len(found.claims) == 14


# -- which cells are compared: those of one setting --------------------------------------------------------


def test_the_last_sweep_decides(tmp_path: Any) -> None:
    """Agents of a further arm, which fit no others then, are left out as well."""
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, updates=200, baselines=(), further=("mixed",))
    synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, updates=400, baselines=())
    chosen, left_out = comparable(load(tmp_path))
    assert len(left_out) == 9
    assert sum("updates 200 instead of 400" in reason for reason in left_out.values()) == 6
    learners = [cell["learner"] for cell in chosen.cells.values() if "learner" in cell]
    assert {learner["updates"] for learner in learners} == {400}
    assert set(chosen.episodes["cell"]) == set(chosen.cells)


def test_a_baseline_is_compared_though_it_has_no_package_of_the_learner(tmp_path: Any) -> None:
    cells = synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, baselines=("careful",))
    assert {"numba" in cell.versions for cell in cells} == {True, False}
    assert comparable(load(tmp_path))[1] == {}
