"""The analysis of made-up cells, and of made-up scores, whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from experiments.analysis.analysis import Analysis, analyse, as_json, own_agents
from experiments.analysis.cells import comparable, duplicates
from experiments.analysis.claims import CLAIMS, claims
from experiments.analysis.effects import adjusted, contrasts, mean_over, slopes
from experiments.analysis.estimate import interval, linear
from experiments.analysis.gates import learnt
from experiments.analysis.plan import DEFAULT, OUTCOMES, TERMS, TWO_BATCHES, Plan, as_data
from experiments.analysis.scores import CRASH_KINDS, Arm, Arms, Place, arms_of, kind_of_crash, with_outcomes
from experiments.study.grid import BASELINES
from experiments.study.results import Results, load
from sumo_env.tasks import TASKS
from tests.experiments import synthetic

FAULTS = {
    "sumo-highway-100-control-s0": "diverged",
    "sumo-highway-100-treatment-s2": "constant",
    "sumo-u-turn-3-control-s1": "tied",
    "sumo-u-turn-6-treatment-s3": "poor",
}
PAIR = [("treatment", "control")]


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    directory = tmp_path_factory.mktemp("results")
    synthetic.write(directory, {"highway": (1, 2), "u-turn": (1, 2, 3)}, seeds=4, faults=FAULTS, effect=-0.2)
    return load(directory)


@pytest.fixture(scope="module")
def analysis(results: Results) -> Analysis:
    return analyse(results)


def find(frame: pd.DataFrame, **wanted: Any) -> dict[str, Any]:
    """The one row with these values, of treatment against control at home where that is a question."""
    if "scenarios" in frame:
        wanted = {"arm": "treatment", "against": "control", "scenarios": "own", **wanted}
    for name, value in wanted.items():
        frame = frame[frame[name] == value]
    [row] = frame.to_dict("records")
    return {str(key): value for key, value in row.items()}


def agents(
    levels: int,
    seeds: int,
    random: np.random.Generator,
    effect: float = 0.0,
    spread: float = 1.0,
    task: str = "highway",
    growth: float = 0.0,
) -> dict[Place, Arms]:
    """Settings of one task, each agent with nearly the same score in all scenarios, in every outcome."""
    result: dict[Place, Arms] = {}
    for level in range(1, levels + 1):
        pair = {}
        for arm in ("control", "treatment"):
            own = random.normal(0, spread, (1, seeds, 1)) + random.normal(0, 0.3 * spread, (2, seeds, 1))
            added = (effect + growth * level) * (arm == "treatment")
            scores = 10 + own + added + random.normal(0, 0.01 * spread, (2, seeds, 5))
            pair[arm] = Arm(tuple(range(seeds)), {name: scores.copy() for name in OUTCOMES})
        result["sumo", task, level, str(level)] = pair
    return result


def effects(arms: dict[Place, Arms], plan: Plan = DEFAULT) -> pd.DataFrame:
    return adjusted(contrasts(arms, PAIR, [(o, t) for o in OUTCOMES for t in TERMS], plan), plan)


def arms_in(results: Results) -> dict[Place, dict[str, Arm]]:
    return arms_of(own_agents(with_outcomes(results)), list(OUTCOMES))


class TestPlan:
    def test_is_in_the_analysis_with_its_digest(self, analysis: Analysis) -> None:
        assert analysis.plan["version"] == 2 and len(analysis.plan_hash) == 64

    @pytest.mark.parametrize("plan", [DEFAULT, TWO_BATCHES])
    def test_what_a_family_tests_is_not_called_exploratory(self, plan: Plan) -> None:
        named = as_data(plan, {})["exploratory"]
        assert f"{plan.primary_outcome} {plan.primary_term}" not in named
        tested = [(o, t) for o in OUTCOMES for t in TERMS if plan.family("treatment", o, t)]
        assert tested
        assert [f"{o} {t}" for o, t in tested if f"{o} {t}" in named] == []


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

    def test_every_place_outcome_and_term_is_there_once(self, analysis: Analysis) -> None:
        rows = analysis.effects.query("arm == 'treatment' and against == 'control'")
        keys = rows[["task", "level", "outcome", "term"]].drop_duplicates()
        assert len(keys) == len(rows) == 5 * (len(OUTCOMES) * len(TERMS) + 2 * len(CRASH_KINDS))

    def test_families_by_holm_and_the_rest_by_benjamini_hochberg(self, analysis: Analysis) -> None:
        rows = analysis.effects[analysis.effects["family"].notna()]
        for (name,), own in rows.groupby(["family"]):
            p = own["p"].dropna().sort_values().to_numpy(float)
            if name:
                expected = np.maximum.accumulate(p * np.arange(len(p), 0, -1)).clip(max=1)
            else:
                expected = stats.false_discovery_control(p.clip(0, 1))
            assert own["p_adjusted"].dropna().sort_values().to_numpy(float) == pytest.approx(
                np.sort(expected)
            )
        assert set(rows["family"]) == {"safety", "harm", "paper", ""}

    def test_the_interval_at_the_familys_level_excludes_zero_only_where_holm_rejects(
        self, analysis: Analysis
    ) -> None:
        rows = analysis.effects[analysis.effects["low_family"].notna()]
        excluded = (rows["low_family"] > 0) | (rows["high_family"] < 0)
        assert len(rows) and (rows.loc[excluded, "p_adjusted"] < 0.05).all()

    def test_the_detectable_effect_is_the_one_at_the_level_that_decides(self, analysis: Analysis) -> None:
        rows = analysis.effects[analysis.effects["detectable"].notna()]
        for row in rows.itertuples():
            limit = stats.t.ppf(1 - 0.05 / 5 / 2, row.df)
            assert stats.nct.sf(limit, row.df, row.detectable / row.se) == pytest.approx(0.8, abs=0.01)

    def test_agents_that_do_not_vary_are_degenerate(self) -> None:
        """Six diverged agents that all drive the same: an effect of exactly 0 is no finding."""
        rows = effects(agents(1, 3, np.random.default_rng(0), spread=0.0)).query("outcome == 'return'")
        assert set(rows["status"]) == {"degenerate"} and set(rows["estimate"]) == {0.0}
        assert rows[["low", "p", "p_adjusted"]].isna().all(axis=None)

    @pytest.mark.parametrize(("regular", "status"), [(1.0, "no information"), (0.0, "ok")])
    def test_a_setting_where_everybody_crashes_says_nothing(self, regular: float, status: str) -> None:
        values = np.stack([np.full((4, 30), regular), np.full((4, 30), 0.5)])
        arm = Arm(tuple(range(4)), dict.fromkeys(OUTCOMES, values))
        rows = effects({("sumo", "highway", 1, "50"): {"treatment": arm, "control": arm}})
        found = find(rows, outcome="crashed", term="regular")
        assert (found["status"], bool(np.isnan(found["p"]))) == (status, status != "ok")
        assert bool(found["equivalent_p_adjusted"] < 0.05) == (status == "ok")

    def test_crashes_per_distance_are_a_ratio_of_sums(self, results: Results, analysis: Analysis) -> None:
        rows = results.episodes.query(
            "task == 'highway' and level == 1 and arm == 'control' and traffic == 'risky'"
        )
        sums = rows.groupby("seed")[["crashed", "distance"]].sum()
        row = find(analysis.effects, task="highway", level=1, outcome="crashes_per_100_km", term="risky")
        assert row["mean_against"] == pytest.approx((sums["crashed"] / sums["distance"] * 1e5).mean())

    def test_the_time_to_crash_is_at_most_the_episodes(self, results: Results, analysis: Analysis) -> None:
        rows = results.episodes.query(
            "task == 'highway' and level == 1 and arm == 'control' and traffic == 'risky'"
        )
        time = rows["crash_time"].astype(float).where(rows["crashed"], rows["length"])  # one step in a second
        row = find(analysis.effects, task="highway", level=1, outcome="crash_free_time", term="risky")
        assert row["mean_against"] == pytest.approx(time.groupby(rows["seed"]).mean().mean())

    def test_the_first_look_has_a_fifth_of_the_error_rate(self) -> None:
        arms = agents(1, 5, np.random.default_rng(1), effect=1.0)
        one, two = (
            find(effects(arms, plan), outcome="return", term="sum") for plan in (DEFAULT, TWO_BATCHES)
        )
        assert two["p"] == pytest.approx(min(1, one["p"] / 0.2))
        assert (two["low"], two["high"]) == (one["low"], one["high"])

    def test_both_looks_count_when_all_seeds_are_there(self) -> None:
        arms = agents(1, 10, np.random.default_rng(2), effect=1.0)
        early = {place: {name: arm.below(5) for name, arm in pair.items()} for place, pair in arms.items()}
        first, last = (find(effects(found), outcome="return", term="sum")["p"] for found in (early, arms))
        both = find(effects(arms, TWO_BATCHES), outcome="return", term="sum")["p"]
        assert both == pytest.approx(min(1, first / 0.2, last / 0.8))


class TestNeverCrashed:
    def test_is_evidence(self, results: Results) -> None:
        safe = changed(results, crashed=lambda rows: rows["crashed"] & (rows["arm"] == "control"))
        found = effects(arms_in(safe))
        for term in ("risky", "regular", "sum"):
            row = find(found, task="highway", level=1, outcome="crashed", term=term)
            assert row["status"] == "ok" and row["high"] < 0

    def test_in_both_arms_is_equivalence(self, results: Results) -> None:
        found = effects(arms_in(changed(results, crashed=lambda rows: rows["crashed"] & False)))
        row = find(found, task="highway", level=1, outcome="crashed", term="regular")
        assert row["estimate"] == 0 and row["low"] < 0 < row["high"]
        assert row["equivalent_p"] < 0.05


def changed(results: Results, **columns: Callable[[pd.DataFrame], Any]) -> Results:
    """The results with other test episodes: each column a function of the table, for the trained agents."""
    episodes = results.episodes.copy()
    own = episodes["kind"] == "agent"
    for column, value in columns.items():
        episodes[column] = episodes[column].astype(object)
        episodes.loc[own, column] = value(results.episodes[own])
        episodes[column] = episodes[column].astype(results.episodes[column].dtype)
    return replace(results, episodes=episodes)


class TestMeans:
    def test_every_task_weighs_the_same_over_all_agents(self, analysis: Analysis) -> None:
        mean = find(analysis.means, scope="all tasks", outcome="crashed", term="risky")
        rows = analysis.effects.query("outcome == 'crashed' and term == 'risky' and against == 'control'")
        assert mean["settings"] == len(rows) == 5
        assert mean["estimate"] == pytest.approx(rows.groupby("task")["estimate"].mean().mean())
        assert mean["estimate"] == pytest.approx(mean["mean_arm"] - mean["mean_against"])

    def test_settings_alike_is_another_mean(self, analysis: Analysis) -> None:
        rows = analysis.effects.query("outcome == 'crashed' and term == 'risky' and against == 'control'")
        mean = find(analysis.means, scope="every setting alike", outcome="crashed", term="risky")
        assert mean["estimate"] == pytest.approx(rows["estimate"].mean())

    def test_its_variance_is_that_of_a_weighted_sum(self) -> None:
        rows = contrasts(agents(3, 6, np.random.default_rng(5)), PAIR, [("return", "risky")])
        assert mean_over(rows, DEFAULT)["se"] == pytest.approx(np.sqrt((rows["se"] ** 2).sum()) / 3)

    def test_without_looks_it_is_of_all_agents_whatever_looks_its_effects_have(self) -> None:
        arms = agents(2, 10, np.random.default_rng(5))
        found = [
            mean_over(contrasts(arms, PAIR, [("return", "risky")], plan), DEFAULT)
            for plan in (DEFAULT, TWO_BATCHES)
        ]
        assert found[0] == found[1]

    def test_returns_of_different_tasks_are_not_averaged(self, analysis: Analysis) -> None:
        assert set(analysis.means.query("outcome == 'return'")["scope"]) == {"highway", "u-turn"}

    def test_each_task_is_left_out_once(self, analysis: Analysis) -> None:
        for task, other in (("highway", "u-turn"), ("u-turn", "highway")):
            without = find(analysis.means, scope=f"without {task}", outcome="crashed", term="risky")
            alone = find(analysis.means, scope=other, outcome="crashed", term="risky")
            assert without["estimate"] == pytest.approx(alone["estimate"])

    def test_agents_that_fail_the_gates_are_left_out_of_one_variant(
        self, results: Results, analysis: Analysis
    ) -> None:
        mean = find(analysis.means, scope="agents that pass the gates", outcome="crashed", term="risky")
        assert (mean["seeds_arm"], mean["seeds_against"]) == (18, 18)

    def test_a_setting_is_learnt_if_its_control_agents_are(self, analysis: Analysis) -> None:
        rows = analysis.gates.assign(passed=analysis.gates["task"] == "highway")
        assert learnt(rows, 0.5) == {("sumo", "highway", 1), ("sumo", "highway", 2)}
        rows["passed"] |= rows["seed"] > 1  # two of four
        assert len(learnt(rows, 0.5)) == 5
        assert learnt(rows.assign(passed=rows["arm"] == "treatment"), 0.5) == set()

    def test_the_careful_driver_is_compared_scenario_by_scenario(
        self, results: Results, analysis: Analysis
    ) -> None:
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

    def test_knows_that_each_level_has_test_scenarios_of_its_own(self, results: Results) -> None:
        """Agents that hardly differ, and scenarios that do: nothing grows with traffic."""
        random = np.random.default_rng(5)
        luck, noise = random.normal(0, 2.0, (6, 40)), random.normal(0, 0.05, len(results.episodes))

        def returns(rows: pd.DataFrame) -> np.ndarray:
            drawn: np.ndarray = 10 + luck[rows["level"], rows["scenario"]] + noise[: len(rows)]
            return drawn

        found = slopes(arms_in(changed(results, **{"return": returns})))
        slope = find(found, task="u-turn", outcome="return", quantity="mean")
        assert slope["high"] - slope["low"] > 0.2
        assert slope["low"] < 0 < slope["high"]

    def test_over_some_of_the_levels_decides_nothing(self) -> None:
        found = slopes(agents(2, 8, np.random.default_rng(4), spread=0.1, growth=3.0))
        assert not found["complete"].any()
        verdicts = claims(effects(agents(2, 8, np.random.default_rng(4))), found)
        row = find(verdicts, name="return effect grows")
        assert (row["verdict"], row["silent"], row["right"]) == ("not decided", 1, 0)


def made_up(**columns: Any) -> pd.DataFrame:
    """Rows of effects with what claims are made of."""
    usual = {"backend": "sumo", "task": "highway", "status": "ok", "se": 0.01, "df": 8.0, "detectable": 0.3}
    usual |= {"equivalent_p": np.nan, "equivalent_p_adjusted": np.nan}
    rows = pd.DataFrame(columns)
    return rows.assign(**{name: value for name, value in usual.items() if name not in columns})


class TestClaims:
    @staticmethod
    def decide(*values: tuple[float, float], status: str = "ok", expected: int = 18) -> dict[str, Any]:
        """The verdict on "the return rises" from estimates and p-values, in so many of 18 settings."""
        p = np.array([p for _, p in values])
        rows = made_up(outcome="return", term="sum", status=status, estimate=[e for e, _ in values], p=p)
        rows["p_adjusted"] = (p * len(p)).clip(max=1)
        return find(claims(rows, slopes({})), name="return rises")

    def test_holds_if_each_does_by_itself(self) -> None:
        """Everywhere at once is the harder claim: it needs no adjustment for the number of places."""
        assert self.decide(*[(1, 0.04)] * 18)["verdict"] == "holds"
        assert self.decide(*[(1, 0.01)] * 17, (2, 0.06))["verdict"] == "not decided"

    def test_contradicted_only_after_adjustment(self) -> None:
        assert self.decide(*[(1, 0.001)] * 17, (-2, 0.04))["verdict"] == "not decided"
        found = self.decide(*[(1, 0.001)] * 17, (-2, 0.001))
        assert (found["verdict"], found["right"], found["wrong"]) == ("contradicted", 17, 1)

    def test_places_that_were_not_run_keep_it_open(self) -> None:
        found = self.decide((1, 0.001), (2, 0.001))
        assert (found["verdict"], found["right"], found["not_run"]) == ("not decided", 2, 16)

    @pytest.mark.parametrize("status", ["degenerate", "one seed", "no information"])
    def test_what_is_no_evidence_counts_neither_way(self, status: str) -> None:
        found = self.decide((-2, 0.001), status=status)
        assert (found["verdict"], found["wrong"], found["silent"]) == ("not decided", 0, 1)

    @pytest.mark.parametrize(
        ("estimate", "verdict"), [(0.001, "holds"), (0.05, "not decided"), (0.2, "contradicted")]
    )
    def test_little_harm_is_an_equivalence(self, estimate: float, verdict: str) -> None:
        p = float(stats.t.sf((0.05 - estimate) / 0.01, 8))
        rows = made_up(outcome="crashed", term="regular", estimate=[estimate] * 18, p=0.01, p_adjusted=0.01)
        rows = rows.assign(equivalent_p=p, equivalent_p_adjusted=p)
        assert find(claims(rows, slopes({})), name="little harm")["verdict"] == verdict

    def test_signs_are_those_of_the_claims(self) -> None:
        """An effect that raises return and crash rate, both of which rise with traffic."""
        arms: dict[Place, Arms] = {}
        for task, definition in TASKS.items():
            own = agents(
                len(definition.levels), 8, np.random.default_rng(6), effect=3.0, spread=0.1, task=task
            )
            for (_, _, level, _), pair in own.items():
                for arm in pair.values():
                    for name in ("return", "crashed"):
                        arm.values[name][...] += level
            arms |= own
        found = claims(effects(arms), slopes(arms)).set_index("name")["verdict"]
        assert found["return rises"] == "holds"
        assert found["return falls with traffic"] == "contradicted"
        assert found["fewer crashes"] == "contradicted"
        assert found["crashes rise with traffic"] == "holds"
        assert found["little harm"] == "contradicted"

    def test_all_seven_for_each_simulator(self, analysis: Analysis) -> None:
        assert list(analysis.claims["name"]) == [claim.name for claim in CLAIMS]


class TestGatesOfAnAnalysis:
    @pytest.mark.parametrize(
        ("slug", "failed"),
        [
            ("sumo-highway-100-control-s0", "q_bounded"),
            ("sumo-highway-100-treatment-s2", "not_constant"),
            ("sumo-u-turn-3-control-s1", "not_constant"),
            ("sumo-u-turn-6-treatment-s3", "beats_constant"),
        ],
    )
    def test_each_catches_its_fault(self, analysis: Analysis, slug: str, failed: str) -> None:
        [row] = [r for r in analysis.gates.to_dict("records") if r["cell"].startswith(slug + "-")]
        assert row["passed"] is False and failed in row["failed"].split() and not row[failed]

    def test_sound_agents_pass(self, analysis: Analysis) -> None:
        assert analysis.gates["passed"].tolist().count(True) == 36


class TestSettingsAreNotMixed:
    def test_the_last_sweep_decides(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, updates=200, baselines=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, updates=400)
        chosen = comparable(load(tmp_path))
        assert len(chosen.left_out) == 6
        assert all("updates 200 instead of 400" in reason for reason in chosen.left_out.values())
        assert set(chosen.results.agents["updates"].dropna()) == {400}
        assert set(chosen.results.episodes["cell"]) == set(chosen.results.cells)

    def test_baselines_of_another_test_are_left_out(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=10, arms=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=20, baselines=())
        left_out = comparable(load(tmp_path)).left_out
        assert len(left_out) == len(BASELINES)
        assert all("episodes 10 instead of 20" in reason for reason in left_out.values())

    def test_presets_are_labels(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, preset="quick")
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, preset="paper")
        found = analyse(load(tmp_path))
        assert found.notes["left_out"] == {} and found.effects["seeds_arm"].iloc[0] == 3
        assert found.provenance["presets"] == ["paper", "quick"]

    def test_cells_that_fit_no_comparison_are_left_out_and_named(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, further=("dense",), updates=200)
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, updates=400)
        found = comparable(load(tmp_path))
        assert "dense" not in set(found.results.episodes["arm"])
        assert len(found.left_out) == 6


class TestIncompleteData:
    @pytest.mark.parametrize(
        ("damage", "words"),
        [
            (
                lambda rows: rows.assign(**{"return": rows["return"].where(rows["scenario"] > 3)}),
                "not a number",
            ),
            (lambda rows: rows.assign(**{"return": np.inf}), "not a number"),
            (lambda rows: rows[rows["scenario"] < 7], "7 of 20 test scenarios in regular traffic"),
            (lambda rows: rows[rows["traffic"] == "regular"], "0 of 20 test scenarios in risky traffic"),
            (lambda rows: pd.concat([rows, rows.iloc[:1]]), "some twice"),
        ],
    )
    def test_is_named_and_not_counted(self, results: Results, damage: Any, words: str) -> None:
        name = next(name for name in results.cells if "u-turn-3-treatment" in name)
        own = results.episodes["cell"] == name
        episodes = pd.concat([results.episodes[~own], damage(results.episodes[own])], ignore_index=True)
        found = comparable(replace(results, episodes=episodes))
        assert list(found.incomplete) == [name] and words in found.incomplete[name]
        assert set(found.results.cells) == set(results.cells) - {name} == set(found.results.episodes["cell"])

    def test_the_same_agent_twice_is_noticed(self, results: Results) -> None:
        others = [name for name in results.cells if "u-turn-3-treatment" in name][:2]
        cells = {key: {**cell} for key, cell in results.cells.items()}
        for other in others:
            cells[other]["learner"] = {**cells[other]["learner"], "weights_sha256": "0"}
        assert duplicates(replace(results, cells=cells)) == [sorted(others)]


class TestAnalysis:
    def test_is_strict_json_of_twelve_digits(self, analysis: Analysis) -> None:
        value = as_json(analysis)
        assert json.loads(json.dumps(value, allow_nan=False)) == value
        numbers = [x for row in value["means"]["rows"] for x in row if isinstance(x, float)]
        assert numbers and all(x == float(f"{x:.12g}") for x in numbers)

    def test_is_a_pure_function(self, results: Results, analysis: Analysis) -> None:
        shuffled = replace(
            results,
            cells=dict(reversed(results.cells.items())),
            episodes=results.episodes.sample(frac=1, random_state=1).reset_index(drop=True),
        )
        again = analyse(shuffled)
        for name in ("effects", "means", "claims", "gates", "policies"):
            own, other = (getattr(a, name).drop(columns="looks", errors="ignore") for a in (analysis, again))
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
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2)
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, backend="highway-env")
        found = analyse(load(tmp_path))
        rows = (
            found.effects[["backend", "seeds_arm", "seeds_against"]]
            .query("seeds_against > 1")
            .drop_duplicates()
        )
        assert {tuple(row) for row in rows.to_numpy()} == {("sumo", 2, 2), ("highway-env", 3, 3)}
        assert len(found.claims) == 14


LEVELS = {"highway": (1,), "u-turn": (1,)}
FURTHER = ("dense", "penalty", "dose25", "dose50", "dose75")
STUDY: dict[str, Any] = {"seeds": 4, "tests": 40, "effect": -0.4, "spread": 0.01}


class TestFurther:
    """Arms and tests beside the plan."""

    @pytest.fixture(scope="class")
    def results(self, tmp_path_factory: pytest.TempPathFactory) -> Results:
        home = tmp_path_factory.mktemp("further")
        elsewhere = ("replica", "highway-env")
        synthetic.write(home, LEVELS, **STUDY, further=FURTHER, test_on=elsewhere)
        return load(home)

    @pytest.fixture(scope="class")
    def analysis(self, results: Results) -> Analysis:
        return analyse(results)

    def test_nothing_that_the_plan_decides_changes(self, analysis: Analysis, tmp_path: Any) -> None:
        synthetic.write(tmp_path, LEVELS, **STUDY)
        alone = analyse(load(tmp_path))
        own = [
            found.effects[found.effects["family"].notna()].drop(columns="looks")
            for found in (analysis, alone)
        ]
        pd.testing.assert_frame_equal(
            own[0].reset_index(drop=True), own[1].reset_index(drop=True), check_dtype=False
        )
        for name in ("claims", "slopes", "placebo"):
            pd.testing.assert_frame_equal(getattr(analysis, name), getattr(alone, name))
        assert analysis.notes["left_out"] == {} and analysis.notes["incomplete"] == {}

    def test_the_positive_control_is_found(self, analysis: Analysis) -> None:
        row = find(analysis.means, arm="penalty", scope="all tasks", outcome="crashed", term="regular")
        assert row["high"] < 0 and row["estimate"] == pytest.approx(synthetic.PENALTY, abs=0.06)

    def test_dense_traffic_is_compared_with_both_arms(self, analysis: Analysis) -> None:
        wanted = {"arm": "dense", "scope": "all tasks", "outcome": "crashed", "term": "risky"}
        assert abs(find(analysis.means, **wanted)["estimate"]) < 0.1
        assert find(analysis.means, **wanted, against="treatment")["low"] > 0

    def test_doses_are_ordered(self, analysis: Analysis) -> None:
        rows = analysis.policies.query("traffic == 'risky' and task == 'highway'").set_index("arm")["crashed"]
        rates = rows.loc[["control", "dose25", "dose50", "dose75", "treatment"]].tolist()
        assert rates == sorted(rates, reverse=True)

    def test_agents_are_compared_on_other_simulators(self, analysis: Analysis) -> None:
        wanted = {"scope": "all tasks", "outcome": "crashed", "term": "risky"}
        home = {}
        for simulator in ("replica", "highway-env"):
            away = find(analysis.means, **wanted, scenarios=simulator, tested_on=simulator)
            home[simulator] = find(analysis.means, **wanted, scenarios=simulator, tested_on="sumo")
            assert away["high"] < 0 and away["seeds_arm"] == home[simulator]["seeds_arm"] == 8
        over_all_scenarios = find(analysis.means, **wanted)["estimate"]
        assert home["replica"]["estimate"] == pytest.approx(over_all_scenarios)
        assert home["highway-env"]["estimate"] != pytest.approx(over_all_scenarios)  # the first 20 alone

    def test_an_agent_that_is_lost_at_home_is_not_compared_elsewhere(self, results: Results) -> None:
        lost = next(
            n
            for n, c in results.cells.items()
            if (c["key"]["kind"], c["key"]["arm"]) == ("agent", "treatment")
        )
        cells = {name: cell for name, cell in results.cells.items() if name != lost}
        episodes = results.episodes[results.episodes["cell"] != lost]
        gates = results.gate_episodes[results.gate_episodes["cell"] != lost]
        found = analyse(replace(results, cells=cells, episodes=episodes, gate_episodes=gates)).means
        for tested_on in ("replica", "sumo"):
            wanted = {"outcome": "crashed", "term": "risky", "scenarios": "replica"}
            row = find(found, scope="all tasks", tested_on=tested_on, **wanted)
            assert (row["seeds_arm"], row["seeds_against"]) == (7, 8)

    def test_kinds_of_crashes_add_up(self, analysis: Analysis) -> None:
        wanted = {"scope": "all tasks", "term": "risky"}
        parts = [find(analysis.means, **wanted, outcome=kind)["estimate"] for kind in CRASH_KINDS]
        assert sum(parts) == pytest.approx(find(analysis.means, **wanted, outcome="crashed")["estimate"])


@pytest.mark.parametrize(
    ("kind", "x", "y", "heading", "named"),
    [
        ("rear-end", 5.0, 0.2, 0.0, "rear-end, striking"),
        ("rear-end", -5.0, 0.2, 0.0, "rear-end, struck"),
        ("rear-end", 4.9, 1.0, -0.1, "cut-in"),  # ahead on the right, coming to the left
        ("side", 1.0, -2.0, 0.2, "cut-in"),
        ("side", 1.0, -2.0, -0.2, "side"),  # moving away
        ("frontal", 5.0, 0.0, 3.1, "frontal"),
        ("junction", 3.5, 0.0, 1.5, "junction, striking"),
        ("junction", 0.5, 3.4, 1.5, "junction, struck"),
    ],
)
def test_a_crash_is_named(kind: str, x: float, y: float, heading: float, named: str) -> None:
    row = {"crash_type": kind, "crashed": 1.0}
    row |= {"crash_relative_x": x, "crash_relative_y": y, "crash_relative_heading": heading}
    none = {**dict.fromkeys(row), "crashed": 0.0}
    assert kind_of_crash(pd.DataFrame([row, none])).tolist() == [named, ""]


def test_a_treatment_that_ruins_agents_is_no_success(tmp_path: Any) -> None:
    """On one task all treated agents fail the gates, and crash: the answer counts them."""
    faults = {f"sumo-highway-50-treatment-s{seed}": "poor" for seed in range(4)}
    synthetic.write(tmp_path, {"highway": (1,), "u-turn": (1,)}, seeds=4, tests=40, effect=0.0, faults=faults)
    ruined = changed(
        load(tmp_path),
        crashed=lambda rows: rows["crashed"] | ((rows["task"] == "highway") & (rows["arm"] == "treatment")),
    )
    found = analyse(ruined)
    assert find(found.means, scope="all tasks", outcome="crashed", term="risky")["low"] > 0
    assert found.gates.query("arm == 'treatment'")["passed"].tolist().count(False) == 4
