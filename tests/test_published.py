"""What the README and the study's page tell of the published results is what the stored results say."""

from __future__ import annotations

import pandas as pd

from experiments.analysis.analysis import Analysis, stored
from experiments.analysis.effects import means
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


def test_the_readme_tells_the_numbers_of_both_studies() -> None:
    second, first = published("second"), published("standard")
    shown = [
        crashes(second, scope="without u-turn")["risky"],
        dense_intersection(second),
        *(crashes(second, arm="mixed")[term].split()[0] for term in TRAFFICS),
        *(crashes(second, arm="mixed-seen")[term] for term in TRAFFICS),
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
    here = "treated agents cover {} m per second of the time limit, the others {}; "
    here += "always choosing SLOWER covers {} and crashes in {}"
    assert here.format(*found["second"][0]) in told("README.md")
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
    assert f"With the longer clock it is {u_turn.replace(' points', '')}" in text
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
    road = study.price.query("scope == 'two-way' and term == 'regular'").iloc[0]
    assert f"loses {100 * lost['estimate']:.1f} points" in text
    upper = f"at most {100 * harm['high']:.1f} (2.5 asked), on the two-way road {100 * road['high']:.1f}"
    assert upper in text
    verdicts = study.price.query("scope != 'all tasks'").set_index(["term", "scope"])["verdict"].eq("holds")
    assert set(verdicts["risky"][verdicts["risky"]].index) == {"highway", "two-way", "intersection"}
    assert set(verdicts["regular"][~verdicts["regular"]].index) == {"two-way", "intersection"}
    away = crashes(study, tested_on="replica", scenarios="replica")
    assert [words for words in away.values() if words not in text] == []
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
    gates = study.gates.assign(two_way=study.gates["task"] == "two-way")
    bounded = gates[gates["two_way"]]["q_bounded"].astype(bool)
    assert f"the values of {(~bounded).sum()} of {len(bounded)} agents" in text
    elsewhere = gates[~gates["two_way"]]["passed"].astype(bool)
    assert f"{elsewhere.sum()} of {len(elsewhere)} agents pass every gate" in text
    dense = gates.query("task == 'roundabout' and level_name == '15'")
    assert f"{(dense['failed'] == 'beats_constant').sum()} of {len(dense)} agents do not return more" in text
    late = study.learner.query("check == 'last second' and task == 'roundabout' and arm == 'treatment'")
    assert "1.4 times [1.0, 1.9]" in text
    assert late[["estimate", "low", "high"]].round(1).values.tolist() == [[1.4, 1.0, 1.9]]
    above = study.frontier.query("task == 'u-turn' and traffic == 'risky'").set_index("arm")
    row = 100 * above.loc["treatment", ["estimate", "low", "high"]].astype(float)
    assert "(+{:.1f} points [{:.1f}, +{:.1f}])".format(*row).replace("-", "−") in text
    assert f"crash {100 * above.loc['control', 'estimate']:.0f} points more often" in text


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
    same = rows[rows["task"].isin(tasks) & (rows["level"] == 1)].groupby(["arm", "term"])["estimate"].mean()
    beside = [
        f"{100 * same[arm, term]:+.1f}" for arm in ("treatment", "mixed") for term in ("risky", "regular")
    ]
    words = "treated agents have {} and {} and mixed ones {} and {}".format(*beside)
    assert words.replace("-", "−") in text
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
