"""What the README and the study's page tell of the published results is what the stored results say."""

from __future__ import annotations

import pandas as pd

from experiments.analysis.analysis import Analysis, stored
from experiments.analysis.effects import means
from experiments.analysis.gates import CROSSINGS
from experiments.reporting import tables
from experiments.reporting.page import paces
from experiments.reporting.tables import difference, main
from experiments.study.arms import EXTRA_ARMS, TRAFFICS
from experiments.study.store import load
from sumo_env.tasks import TASKS
from tests.pages import ROOT, TEXTS, section, table
from tests.processes import python


def told(page: str) -> str:
    """The text of a page in one line."""
    return " ".join(TEXTS[ROOT / page].split())


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
    return {row["term"]: difference(row) for row in rows.to_dict("records")}


def dense_intersection(analysis: Analysis) -> str:
    """The harm at the densest intersection, as it is told."""
    own = "arm == 'treatment' and against == 'control' and scenarios == 'own' and outcome == 'crashed'"
    rows = analysis.effects.query(f"{own} and task == 'intersection' and level == 5").set_index("term")
    assert rows.loc["regular", "p_adjusted"] < 0.05
    return difference(rows.loc["regular"])


def on_the_tasks_of_mixed_seen(analysis: Analysis) -> list[str]:
    """The mean effects of treatment and of mixed training, in risky and in regular traffic, where mixed-seen is."""
    rows = analysis.effects.query(
        "outcome == 'crashed' and against == 'control' and scenarios == 'own' and level == 1"
    )
    rows = rows[rows["task"].isin(rows.query("arm == 'mixed-seen'")["task"])]
    same = rows.groupby(["arm", "term"])["estimate"].mean()
    numbers = [
        f"{100 * same[arm, term]:+.1f}" for arm in ("treatment", "mixed") for term in ("risky", "regular")
    ]
    return [number.replace("-", "−") for number in numbers]


def test_the_readme_tells_the_numbers_of_both_studies() -> None:
    second, first = published("second"), published("standard")
    shown = [
        crashes(second, scope="without u-turn")["risky"],
        dense_intersection(second),
        *(crashes(second, arm="mixed")[term].split()[0] for term in TRAFFICS),
        *(crashes(second, arm="mixed-seen")[term] for term in TRAFFICS),
        *on_the_tasks_of_mixed_seen(second),
        *(crashes(first)[term] for term in TRAFFICS),
        crashes(first, arm="dense")["risky"],
    ]
    numbers = [words.replace(" points", "") for words in shown]
    assert [number for number in numbers if number not in told("README.md")] == []


def test_progress_is_told_beside_speed() -> None:
    found = {}
    for name in ("second", "standard"):
        policies = published(name).policies
        pace = paces(policies[policies["backend"] == "sumo"])
        slower = f"{100 * pace['slower']['risky']['crashed']:.0f} %"
        found[name] = (
            [f"{pace[arm]['risky']['progress']:.1f}" for arm in ("treatment", "control", "slower")]
            + [slower],
            [f"{pace[arm]['regular']['progress']:.1f}" for arm in ("treatment", "control", "slower")],
        )
    (way, of_control, slowest, rate), (in_regular, control_in_regular, _) = found["second"]
    here = f"cover {way} m per second of the time limit in risky traffic (control agents {of_control}) and "
    here += f"{in_regular} ({control_in_regular}) in regular; always choosing SLOWER covers {slowest} and "
    here += f"crashes in {rate}"
    assert here in told("README.md")
    risky, regular = found["standard"]
    assert "is {} m/s, that of control agents {}.".format(*risky) in told("docs/study.md")
    assert "it is {}, {} and {} m/s".format(*regular) in told("docs/study.md")


def test_crashes_in_the_last_second() -> None:
    told_of = {
        ("standard", "u-turn"): "{late} of {all} crashes of treated agents come in the last",
        ("first-clock", "u-turn"): "{late} of {all} times in the last second",
        ("first-clock", "roundabout"): "({late} of {all} in the last second)",
        ("second", "u-turn"): "{late} of {all} in the last second",
    }
    for (name, task), words in told_of.items():
        wanted = (
            "kind == 'agent' and arm == 'treatment' and traffic == 'regular' and level == 1 and task == @task"
        )
        crashes = load(ROOT / "results" / name).episodes.query(wanted).query("crashed")
        late = int((crashes["crash_time"] > TASKS[task].defaults["duration"] - 1.0).sum())
        assert words.format(late=late, all=len(crashes)) in told("docs/study.md")


def test_the_second_study_is_told_as_it_was_found() -> None:
    study = published("second")
    text = section(TEXTS[ROOT / "docs" / "study.md"], "The second study, so far")
    text = " ".join(text.split())
    own = "arm == 'treatment' and against == 'control' and scenarios == 'own' and level == 1"
    effects = study.effects.query(f"{own} and outcome == 'crashed'").set_index(["task", "term"])
    u_turn = difference(effects.loc["u-turn", "regular"])
    assert (
        f"With the longer clock, whose last seconds no test has, it is {u_turn.replace(' points', '')}"
        in text
    )
    per_way = study.effects.query(
        f"{own} and outcome == 'crashes_per_100_km' and task == 'u-turn' and term == 'regular'"
    )
    assert (
        "per 100 km +{:.1f} [+{:.1f}, +{:.1f}]".format(*per_way.iloc[0][["estimate", "low", "high"]]) in text
    )
    clock = {
        task: {
            term: words.replace(" points", "")
            for term, words in crashes(published("first-clock"), scope=task).items()
        }
        for task in ("u-turn", "roundabout")
    }
    assert f"crash {clock['u-turn']['regular']} more" in text
    assert f"in risky traffic {clock['u-turn']['risky']}" in text
    assert f"roundabout it is {clock['roundabout']['regular']} in regular" in text
    assert f"and {clock['roundabout']['risky']} in risky traffic" in text
    longer = [difference(effects.loc["roundabout", term]).split()[0] for term in ("regular", "risky")]
    assert "with the longer clock {} and {}.".format(*longer) in text
    term = {name: words.replace(" points", "") for name, words in crashes(published("crash-reward")).items()}
    assert f"differ by {term['regular']} in regular and {term['risky']} in risky traffic" in text
    shown = [crashes(study, arm="mixed")[term].split()[0] for term in TRAFFICS]
    shown.append(crashes(study, scope="without two-way")["regular"].replace(" points", ""))
    shown.append(dense_intersection(study).replace(" points", ""))
    assert [number for number in shown if number not in text] == []
    lost, harm = study.price.query("scope == 'all tasks'").to_dict("records")
    assert (lost["verdict"], harm["verdict"]) == ("contradicted", "not decided")
    claim = study.claims.set_index(["name", "quantity"]).loc[("return rises", "sum")]
    assert (claim["verdict"], claim["wrong"]) == ("contradicted", 1)
    whole = "arm == 'treatment' and against == 'control' and outcome == 'return' and term == 'sum'"
    falls = study.effects.query(f"{whole} and scenarios == 'own' and estimate < 0 and p_adjusted < 0.05")
    assert falls[["task", "level_name"]].values.tolist() == [["intersection", "30"]]
    assert f"loses {100 * lost['estimate']:.1f} points of the gain, at most {100 * lost['high']:.1f}" in text
    assert f"its price is at most {100 * harm['high']:.1f} (2.5 asked, not decided;" in text
    limits = (100 * study.price.query("scope != 'all tasks'")["high"]).map("{:.1f}".format).tolist()
    assert study.price["scope"].tolist() == [*TASKS, "all tasks"] * 2
    both = ", ".join(limits[:5]), ", ".join(limits[5:]).replace("-", "−")
    assert f"as above, {both[0]});" in text and f"not decided; {both[1]}; one-sided limits)" in text
    verdicts = study.price.query("scope != 'all tasks'").set_index(["term", "scope"])["verdict"].eq("holds")
    assert set(verdicts["risky"][verdicts["risky"]].index) == {"highway", "two-way", "intersection"}
    assert set(verdicts["regular"][~verdicts["regular"]].index) == {"two-way", "intersection"}
    away = crashes(study, tested_on="replica", scenarios="replica")
    assert [words for words in away.values() if words not in text] == []
    away = study.means.query("tested_on == 'replica' and term == 'regular' and scope != 'all tasks'")
    there = [f"{100 * x:+.0f}".replace("-", "−") for x in away.set_index("scope")["estimate"]]
    assert f"(two-way road {there[1]}, roundabout and u-turn {there[2]})" in text and there[4] == there[2]
    alone = study.policies.query("traffic == 'only-parameters'").pivot_table(
        "crashed", ["task", "level_name"], "arm"
    )
    worse = alone.sub(alone["control"], axis=0)
    assert (
        f"treated agents {100 * worse.loc[('two-way', '5+2'), 'treatment']:.0f} points more on the two-way"
        in text
    )
    assert (
        f"two-way agents crash {100 * worse.loc[('two-way', '5+2'), 'mixed-seen']:.0f} points more often"
        in text
    )
    assert worse.loc[["roundabout", "intersection"], ["treatment", "mixed"]].lt(0).all(axis=None)
    models = study.policies.query("traffic in ('krauss', 'eidm')").pivot_table(
        "crashed", ["task", "level_name", "traffic"], "arm"
    )
    assert len(models) == 14 and models[["treatment", "mixed"]].lt(models["control"], axis=0).all(axis=None)
    shown = tables.unseen(study, "sumo").set_index(["setting", "traffic"])["treatment"]
    assert shown["u-turn 3", "krauss"].startswith(
        f"{100 * models.loc[('u-turn', '3', 'krauss'), 'treatment']:.1f} % ±"
    )
    change = study.learner.query("check == 'change'").set_index("arm")["estimate"]
    told_changes = "{control:.3f} of its range (control), {treatment:.3f} (treatment) and {mixed:.3f} (mixed)"
    assert told_changes.format(**change).replace("0.", ".") in text
    checks = study.learner
    assert (len(checks), (checks["passed"] == True).sum()) == (11, 4)  # noqa: E712
    assert "Of eleven checks of the learner, four are met." in text
    gated = checks.query("check == 'gates'").iloc[0]
    number, sound = gated["agents"], round(gated["agents"] * gated["estimate"])
    assert f"{sound} of the plan's {number} agents pass every gate" in text
    assert f"{sound} of {number} agents pass every check" in told("README.md")
    unbounded = study.gates.query("q_bounded == False and arm in ('control', 'treatment', 'mixed')")
    assert set(unbounded["task"]) == {"two-way"} and f"the values of {len(unbounded)}, on the two-way" in text
    dense = study.gates.query("task == 'roundabout' and level_name == '15'")
    assert (
        f"{(dense['failed'] == 'beats_constant').sum()} of {len(dense)} agents are not clearly better" in text
    )
    late = checks.query("check == 'last second'").set_index(["task", "arm"])[["estimate", "low", "high"]]
    assert "{:.2f} times [{:.2f}, {:.2f}] as often".format(*late.loc["roundabout", "treatment"]) in text
    control = [f"{late.loc[(task, 'control'), 'estimate']:.2f}"[1:] for task in ("roundabout", "u-turn")]
    assert "control agents there {} and on the u-turn {} times".format(*control) in text
    above = study.frontier.query("task == 'u-turn' and traffic == 'risky'").set_index("arm")
    row = 100 * above.loc["treatment", ["estimate", "low", "high"]].astype(float)
    control = 100 * above.loc["control", "estimate"]
    words = "(+{:.1f} points [{:.1f}, +{:.1f}], over agents; control agents +{:.0f})".format(*row, control)
    assert words.replace("-", "−") in text
    light = study.frontier.query("traffic == 'risky' and level == 1 and arm == 'treatment'").set_index("task")
    assert f"on the light roundabout less (−{-100 * light.loc['roundabout', 'estimate']:.1f})" in text
    assert set(light.index[light["inside"] == 0]) == {"highway", "two-way", "intersection"}
    drives = load(ROOT / "results" / "second").episodes.query("kind == 'agent' and traffic == 'regular'")
    enters = drives.query("task == 'roundabout' and level_name == '15'").groupby("arm")["distance"]
    enters = enters.agg(lambda way: 100 * (way >= CROSSINGS["roundabout"]).mean())
    assert (
        "in {treatment:.0f} % of regular episodes, control agents in {control:.0f} %".format(**enters) in text
    )
    second_step = drives.query("task == 'intersection' and level_name == '30'").groupby("arm")["actions"]
    faster = second_step.agg(lambda actions: 100 * (actions.str[1] == "2").mean())
    assert (
        "{treatment:.0f} % choose FASTER in the second step, control agents {control:.0f} %".format(**faster)
        in text
    )


def test_the_second_studys_exploratory_arms_are_told_as_they_were_found() -> None:
    study = published("second")
    text = " ".join(section(TEXTS[ROOT / "docs" / "study.md"], "The second study, so far").split())
    for arm in ("mixed-seen", "drawn"):
        found = crashes(study, arm=arm)
        assert f"gives {found['risky']} in risky and {found['regular']} in regular traffic" in text
    rows = study.effects.query("outcome == 'crashed' and against == 'control' and scenarios == 'own'")
    drawn = rows.query("arm == 'drawn' and term == 'regular'").set_index("task")["estimate"]
    assert set(drawn.index) == set(TASKS)
    assert drawn.idxmax() == "two-way" and f"on the two-way road +{100 * drawn.max():.0f}." in text
    tasks = rows.query("arm == 'mixed-seen'")["task"].unique()
    assert set(tasks) == {"two-way", "roundabout", "u-turn"}
    words = "treated agents have {} and {} and mixed ones {} and {}"
    assert words.format(*on_the_tasks_of_mixed_seen(study)) in text
    gates = study.gates.query("arm == 'mixed-seen' and task == 'two-way'")["q_bounded"].astype(bool)
    assert f"{(~gates).sum()} of {len(gates)} two-way agents exceed the bound" in text


def test_the_studys_page_tells_what_further_arms_do() -> None:
    analysis = published("standard")
    text = section(TEXTS[ROOT / "docs" / "study.md"], "Risk or more interaction?")
    line = " ".join(text.split())
    means = {arm: crashes(analysis, arm=arm) for arm in ("dose25", "dose50", "dose75", "penalty", "dense")}
    shown = [means[arm][term] for arm in ("dose25", "dose50", "dose75", "penalty") for term in TRAFFICS]
    shown += [means["dense"]["risky"]]
    assert [words for words in shown if words not in line] == []


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
