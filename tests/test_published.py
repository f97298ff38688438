"""What the README and the study's page tell of the published results is what the stored results say."""

from __future__ import annotations

from collections.abc import Iterable

import pandas as pd

from experiments.analysis.analysis import Analysis, stored
from experiments.analysis.effects import means
from experiments.analysis.gates import CROSSINGS
from experiments.reporting import tables
from experiments.reporting.page import paces
from experiments.reporting.tables import difference, main
from experiments.study.design.arms import EXTRA_ARMS, TRAFFICS
from experiments.study.results.store import load
from sumo_env.tasks import TASKS
from tests.pages import ROOT, TEXTS, section, table
from tests.processes import python


def plain(text: str) -> str:
    """A text in one line, with ASCII minus signs and without the unit: a sentence names it once for several numbers."""
    return " ".join(text.split()).replace(" points", "").replace("−", "-")


def told(page: str, title: str = "") -> str:
    """The text of a page, or of one of its sections."""
    return plain(section(TEXTS[ROOT / page], title) if title else TEXTS[ROOT / page])


def assert_told(shown: Iterable[str], text: str) -> None:
    assert [words for words in shown if words not in text] == []


STUDY, SECOND = "docs/study.md", "The second study, so far"
OWN = "against == 'control' and scenarios == 'own'"


def test_the_table_of_the_readme_is_that_of_the_results() -> None:
    python("docs/results_table.py", "--check")


def published(name: str) -> Analysis:
    """The stored analysis of a folder."""
    return stored(ROOT / "results" / name / "analysis.json")


def crashes(analysis: Analysis, **wanted: str) -> dict[str, str]:
    """The mean effect on the crash rate by term, as it is told."""
    asked = {"arm": "treatment", "against": "control", "scenarios": "own", "scope": "all tasks", **wanted}
    rows = analysis.means[analysis.means["outcome"] == "crashed"]
    for column, value in asked.items():
        rows = rows[rows[column] == value]
    return {row["term"]: plain(difference(row)) for row in rows.to_dict("records")}


def dense_harms(analysis: Analysis) -> list[str]:
    """The harms on the densest highway and at the densest intersection, as they are told."""
    rows = analysis.effects.query(
        f"{OWN} and arm == 'treatment' and outcome == 'crashed' and term == 'regular'"
    )
    rows = rows.query("level > 1 and estimate > 0 and p_adjusted < 0.05")
    assert rows["task"].tolist() == ["highway", "intersection"]
    return [plain(difference(row)) for row in rows.to_dict("records")]


def on_the_tasks_of_mixed_seen(analysis: Analysis) -> list[str]:
    """The mean effects of treatment and of mixed training, in risky and in regular traffic, where mixed-seen is."""
    rows = analysis.effects.query(f"{OWN} and outcome == 'crashed' and level == 1")
    rows = rows[rows["task"].isin(rows.query("arm == 'mixed-seen'")["task"])]
    same = rows.groupby(["arm", "term"])["estimate"].mean()
    return [
        f"{100 * same[arm, term]:+.1f}" for arm in ("treatment", "mixed") for term in ("risky", "regular")
    ]


def test_the_readme_tells_the_numbers_of_both_studies() -> None:
    second, first = published("second"), published("standard")
    shown = [
        crashes(second, scope="without u-turn")["risky"],
        *dense_harms(second),
        *(crashes(second, arm="mixed")[term].split()[0] for term in TRAFFICS),
        *(crashes(second, arm="mixed-seen")[term] for term in TRAFFICS),
        *on_the_tasks_of_mixed_seen(second),
        *(crashes(first)[term] for term in TRAFFICS),
        crashes(first, arm="dense")["risky"],
    ]
    assert_told(shown, told("README.md"))


def test_progress_is_told_beside_speed() -> None:
    found = {}
    for name in ("second", "standard"):
        policies = published(name).policies
        pace = paces(policies[policies["backend"] == "sumo"])
        found[name] = {
            f"{arm}_{traffic}": f"{pace[arm][traffic]['progress']:.1f}"
            for arm in ("treatment", "control", "slower")
            for traffic in TRAFFICS
        }
        found[name]["rate"] = f"{100 * pace['slower']['risky']['crashed']:.0f} %"
    readme = (
        "cover {treatment_risky} m per second of the time limit in risky traffic (control agents {control_risky}; "
        "always choosing SLOWER, which crashes in {rate}, {slower_risky}) "
        "and {treatment_regular} ({control_regular}) in regular."
    )
    assert_told([readme.format(**found["second"])], told("README.md"))
    page = [
        "is {treatment_risky} m/s, that of control agents {control_risky}.",
        "it is {treatment_regular}, {control_regular} and {slower_regular} m/s",
    ]
    assert_told([words.format(**found["standard"]) for words in page], told(STUDY))


def test_crashes_in_the_last_second() -> None:
    told_of = {
        ("standard", "u-turn"): "{late} of {all} crashes of treated agents come in the last",
        ("first-clock", "u-turn"): "{late} of {all} times in the last second",
        ("first-clock", "roundabout"): "({late} of {all} in the last second)",
        ("second", "u-turn"): "{late} of {all} in the last second",
    }
    for (name, task), words in told_of.items():
        treated = load(ROOT / "results" / name).episodes.query("kind == 'agent' and arm == 'treatment'")
        crashes = treated.query("traffic == 'regular' and level == 1 and task == @task and crashed")
        late = int((crashes["crash_time"] > TASKS[task].defaults["duration"] - 1.0).sum())
        assert words.format(late=late, all=len(crashes)) in told(STUDY)


def test_the_second_study_is_told_as_it_was_found() -> None:
    study, first = published("second"), published("first-clock")
    treated = study.effects.query(f"{OWN} and arm == 'treatment'")
    single = treated.query("level == 1").set_index(["outcome", "task", "term"])
    shown = {where: plain(difference(row)) for where, row in single.loc["crashed"].iterrows()}
    dense_u_turn = treated.query("outcome == 'crashed' and task == 'u-turn' and level == 4").iloc[1]
    assert dense_u_turn["term"] == "regular"
    per_way = single.loc[("crashes_per_100_km", "u-turn", "regular"), ["estimate", "low", "high"]]
    u_turn, roundabout = (crashes(first, scope=task) for task in ("u-turn", "roundabout"))
    longer = [shown["roundabout", term].split()[0] for term in ("regular", "risky")]
    reward, mixed = crashes(published("crash-reward")), crashes(study, arm="mixed")
    lost, harm = study.price.query("scope == 'all tasks'").to_dict("records")
    limits = (100 * study.price.query("scope != 'all tasks'")["high"]).map("{:.1f}".format).tolist()
    assert study.price["scope"].tolist() == [*TASKS, "all tasks"] * 2
    replica = study.means.query("tested_on == 'replica' and term == 'regular' and scope != 'all tasks'")
    there = [f"{100 * x:+.0f}" for x in replica.set_index("scope")["estimate"]]
    change = study.learner.query("check == 'change'").set_index("arm")["estimate"]
    told_changes = "{control:.3f} of its range (control), {treatment:.3f} (treatment) and {mixed:.3f} (mixed)"
    sentences = [
        f"With the longer clock, whose last seconds no test has, it is {shown['u-turn', 'regular']}",
        "per 100 km +{:.1f} [+{:.1f}, +{:.1f}]".format(*per_way),
        f"with 12 vehicles {plain(difference(dense_u_turn))}",
        f"crash {u_turn['regular']} more",
        f"in risky traffic {u_turn['risky']}",
        f"roundabout it is {roundabout['regular']} in regular",
        f"and {roundabout['risky']} in risky traffic",
        "with the longer clock {} and {}.".format(*longer),
        f"differ by {reward['regular']} in regular and {reward['risky']} in risky traffic",
        *(mixed[term].split()[0] for term in TRAFFICS),
        crashes(study, scope="without two-way")["regular"],
        *dense_harms(study),
        f"loses {100 * lost['estimate']:.1f} of the gain, at most {100 * lost['high']:.1f}",
        f"its price is at most {100 * harm['high']:.2f} (2.5 asked: *not decided*;",
        f"as above, {', '.join(limits[:5])});",
        f"*not decided*; {', '.join(limits[5:])}; one-sided limits)",
        *crashes(study, tested_on="replica", scenarios="replica").values(),
        f"(two-way road {there[1]}, roundabout {there[2]}, u-turn {there[4]})",
        told_changes.format(**change).replace("0.", "."),
    ]
    assert_told(sentences, told(STUDY, SECOND))
    assert (lost["verdict"], harm["verdict"]) == ("contradicted", "not decided")
    risky = study.effects.query(f"{OWN} and outcome == 'crashed' and term == 'risky' and level != 2")
    fewer = risky.assign(fewer=risky.eval("estimate < 0 and p_adjusted < 0.05")).groupby("arm")["fewer"]
    assert fewer.sum()[["treatment", "mixed"]].tolist() == [8, 8]
    open_ones = risky.query("arm in ('treatment', 'mixed') and p_adjusted >= 0.05")
    assert open_ones[["task", "level_name"]].values.tolist() == [["highway", "150"]] * 2
    claim = study.claims.set_index(["name", "quantity"]).loc[("return rises", "sum")]
    assert (claim["verdict"], claim["wrong"]) == ("contradicted", 1)
    falls = treated.query("outcome == 'return' and term == 'sum' and estimate < 0 and p_adjusted < 0.05")
    assert falls[["task", "level_name"]].values.tolist() == [["intersection", "30"]]
    verdicts = study.price.query("scope != 'all tasks'").set_index(["term", "scope"])["verdict"].eq("holds")
    assert set(verdicts["risky"][verdicts["risky"]].index) == {"highway", "two-way", "intersection"}
    assert set(verdicts["regular"][~verdicts["regular"]].index) == {"two-way", "intersection"}


def test_other_traffic_is_told_as_it_was_found() -> None:
    study = published("second")
    rates = study.policies.pivot_table("crashed", ["traffic", "task", "level_name"], "arm")
    alone = rates.loc["only-parameters"]
    worse = 100 * alone.sub(alone["control"], axis=0)
    road = worse.loc[("two-way", "5+2")]
    highway = worse.loc[("highway", "150")]
    sentences = [
        f"but {road['treatment']:.0f} more on the two-way road (mixed agents {road['mixed']:.0f})",
        f"and {highway['treatment']:.0f} on the dense highway.",
        f"two-way agents crash {road['mixed-seen']:.0f} more often",
    ]
    assert_told(sentences, told(STUDY, SECOND))
    assert worse.loc[["roundabout", "intersection"], "treatment"].lt(0).all()
    models = rates.loc[["krauss", "eidm"]]
    assert len(models) == 18 and models[["treatment", "mixed"]].lt(models["control"], axis=0).all(axis=None)
    shown = tables.unseen(study, "sumo").set_index(["setting", "traffic"])["treatment"]
    rate = 100 * models.loc[("krauss", "u-turn", "3"), "treatment"]
    assert shown["u-turn 3", "krauss"].startswith(f"{rate:.1f} % ±")


def with_noise_of_episodes(drives: pd.DataFrame) -> list[float]:
    """95 % limits of treatment minus control in points, of 400 scenarios as if agents were all alike."""
    rates = drives.pivot_table("crashed", "arm", "scenario")
    difference = 100 * (rates.loc["treatment"] - rates.loc["control"])
    return [difference.mean() + sign * 1.966 * difference.sem() for sign in (-1, 1)]


def test_the_second_studys_learner_is_told_as_it_was_found() -> None:
    study = published("second")
    checks, dense = study.learner, study.gates.query("task == 'roundabout' and level_name == '15'")
    assert (len(checks), (checks["passed"] == True).sum()) == (11, 5)  # noqa: E712
    gated = checks.query("check == 'gates'").iloc[0]
    number, sound = gated["agents"], round(gated["agents"] * gated["estimate"])
    assert_told([f"{sound} of {number} agents pass every gate"], told("README.md"))
    unbounded = study.gates.query("q_bounded == False and arm in ('control', 'treatment', 'mixed')")
    assert set(unbounded["task"]) == {"two-way"}
    late = checks.query("check == 'last second'").set_index(["task", "arm"])[["estimate", "low", "high"]]
    assert late.loc["u-turn"].eval("low <= 1 <= high").all()
    above = study.frontier.query("task == 'u-turn' and traffic == 'risky' and level == 1").set_index("arm")
    dense_above = study.frontier.query("task == 'u-turn' and traffic == 'risky' and level == 4").set_index(
        "arm"
    )
    row = 100 * above.loc["treatment", ["estimate", "low", "high"]].astype(float)
    light = study.frontier.query("traffic == 'risky' and level == 1 and arm == 'treatment'").set_index("task")
    assert set(light.index[light["inside"] == 0]) == {"highway", "two-way", "intersection"}
    drives = load(ROOT / "results" / "second").episodes.query("kind == 'agent' and traffic == 'regular'")
    ways = drives.query("task == 'roundabout' and level_name == '15'").groupby("arm")["distance"]
    enters = ways.agg(lambda way: 100 * (way >= CROSSINGS["roundabout"]).mean())
    ended = drives.query("task == 'intersection' and level_name == '30' and crashed")
    kinds = pd.crosstab(ended["arm"], ended["crash_type"])
    more = kinds.loc["treatment"] - kinds.loc["control"]
    on_highway = drives.query("task == 'highway' and level_name == '150'")
    sentences = [
        "Of eleven checks of the learner, five are met.",
        f"{sound} of the plan's {number} agents pass every gate",
        f"the values of {len(unbounded)}, on the two-way",
        f"{(dense['failed'] == 'beats_constant').sum()} of {len(dense)} agents are not clearly better",
        "{:.2f} times [{:.2f}, {:.2f}] as often".format(*late.loc["roundabout", "treatment"]),
        f"control agents there {late.loc[('roundabout', 'control'), 'estimate']:.2f} times".replace(
            " 0.", " ."
        ),
        "(+{:.1f} [{:.1f}, +{:.1f}], over agents;".format(*row),
        f"over agents; control agents +{100 * above.loc['control', 'estimate']:.0f})",
        f"on the dense one ({100 * dense_above.loc['treatment', 'estimate']:.1f}) and",
        f"the light roundabout ({100 * light.loc['roundabout', 'estimate']:.1f}) less",
        "in {treatment:.0f} % of regular episodes, control agents in {control:.0f} %".format(**enters),
        f"{more['rear-end']} of the {more.sum()} additional crashes are rear-end",
        "with that noise [+{:.1f}, +{:.1f}])".format(*with_noise_of_episodes(on_highway)),
    ]
    assert_told(sentences, told(STUDY, SECOND))


def test_the_second_studys_exploratory_arms_are_told_as_they_were_found() -> None:
    study = published("second")
    arms = [crashes(study, arm=arm) for arm in ("mixed-seen", "drawn")]
    rows = study.effects.query(f"{OWN} and outcome == 'crashed'")
    drawn = rows.query("arm == 'drawn' and term == 'regular'").set_index("task")["estimate"]
    assert set(drawn.index) == set(TASKS) and drawn.idxmax() == "two-way"
    assert set(rows.query("arm == 'mixed-seen'")["task"]) == set(TASKS)
    same = "treated agents have {} and {} and mixed ones {} and {}"
    gates = study.gates.query("arm == 'mixed-seen' and task == 'two-way'")["q_bounded"].astype(bool)
    sentences = [
        *(f"gives {found['risky']} in risky and {found['regular']} in regular traffic" for found in arms),
        f"on the two-way road +{100 * drawn.max():.0f}.",
        same.format(*on_the_tasks_of_mixed_seen(study)),
        f"{(~gates).sum()} of {len(gates)} two-way agents exceed the bound",
    ]
    assert_told(sentences, told(STUDY, SECOND))


def test_the_studys_page_tells_what_further_arms_do() -> None:
    means = {
        arm: crashes(published("standard"), arm=arm)
        for arm in ("dose25", "dose50", "dose75", "penalty", "dense")
    }
    shown = [means[arm][term] for arm in means if arm != "dense" for term in TRAFFICS]
    assert_told([*shown, means["dense"]["risky"]], told(STUDY, "Risk or more interaction?"))


def test_the_agents_of_further_arms_pass_the_gates() -> None:
    found = published("standard").gates
    assert found.loc[found["arm"].isin(list(EXTRA_ARMS)), "passed"].tolist() == [True] * 120
    assert "All 120 agents of these arms pass the gates." in TEXTS[ROOT / "docs" / "study.md"]


def test_the_replicas_agents_do_the_same_on_highway_env() -> None:
    found = load(ROOT / "results" / "replica")
    tested = {
        name: cell["key"].get("test_on", {}).get("backend", "replica")
        for name, cell in found.cells.items()
        if cell["key"]["kind"] != "baseline"
    }
    episodes = found.episodes[found.episodes["cell"].isin(tested)]
    simulator = episodes["cell"].map(tested)
    where = ["task", "arm", "seed", "traffic", "scenario"]
    same = ["return", "length", "crashed"]
    here, there = (
        episodes[simulator == name].set_index(where)[same].sort_index() for name in ("replica", "highway-env")
    )
    assert len(there) == 2000
    pd.testing.assert_frame_equal(here.loc[there.index], there, check_exact=True)


def test_the_studys_page_tells_the_numbers_of_every_folder() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "study.md"], "On highway-env's physics"))
    assert set(rows) == {f"results/{path.parent.name}" for path in (ROOT / "results").glob("*/PUBLISHED.md")}
    for name, (_, *shown) in rows.items():
        analysis = published(name.removeprefix("results/"))
        effects = main(analysis.effects, str(analysis.effects["backend"].iloc[0]))
        single = effects.query("outcome == 'crashed' and level == 1").fillna({"se": 0.0, "df": 1.0})
        parts = {
            "variance": single["se"] ** 2,
            "dof": single["df"],
            "smallest": single["seeds_arm"],
            "look": 0,
        }
        over_all = means(single.assign(**parts)).query("scope == 'all tasks'").set_index("term")
        told = [difference(over_all.loc[term]) for term in ("risky", "regular")]
        gates = analysis.gates.query("level == 1 and arm in ('control', 'treatment')")["passed"].tolist()
        assert shown == [*told, f"{gates.count(True)} of {len(gates)}"], name
