"""What the README and the study's page tell of the published results is what the stored results say."""

from __future__ import annotations

import runpy
import subprocess
import sys
from pathlib import Path

import pandas as pd

from experiments.analysis.analysis import Analysis, analyse, as_json, stored
from experiments.analysis.effects import mean_over
from experiments.analysis.plan import Plan
from experiments.reporting.page import paces
from experiments.reporting.tables import main
from experiments.reporting.words import difference
from experiments.study.arms import EXTRA_ARMS, TRAFFICS
from experiments.study.results import load
from sumo_env.tasks import TASKS
from tests.experiments import synthetic
from tests.pages import ROOT, TEXTS, section, table


def told(page: str) -> str:
    """The text of a page in one line."""
    return " ".join(TEXTS[ROOT / page].split())


def test_the_table_of_the_readme_is_that_of_the_results() -> None:
    subprocess.run([sys.executable, ROOT / "docs" / "results_table.py", "--check"], check=True)


def test_the_table_of_the_readme_shows_mixed_training_where_there_is_any(tmp_path: Path) -> None:
    table_of = runpy.run_path(str(ROOT / "docs" / "results_table.py"))
    for further in ((), ("mixed",)):
        synthetic.write(
            tmp_path / str(further), dict.fromkeys(TASKS, (1,)), seeds=3, tests=8, further=further
        )
        analysis = as_json(analyse(load(tmp_path / str(further))))
        shown = table_of["arms"](analysis)
        assert shown == ["control", "treatment", *further]
        text = "".join(table_of["lines"](analysis, shown))
        assert text.count("|\n") == 2 + len(TASKS) + 1
        assert ("→ in mixed traffic" in text) == bool(further)
        [row] = [
            r
            for r in table_of["records"](analysis, "means")
            if (r["arm"], r["against"], r["scope"], r["outcome"], r["term"], r["scenarios"])
            == (shown[-1], "control", "u-turn", "crashed", "regular", "own")
        ]
        last = table_of["difference"](row, 100, 0).replace(" ", table_of["SPACE"])
        [line] = [line for line in text.splitlines() if line.startswith("| u-turn")]
        cell = line.split(" | ")[2]
        assert cell.endswith(last) and cell.count("→") == len(shown) - 1


def published(name: str) -> Analysis:
    """The stored analysis of a folder."""
    found = stored(ROOT / "results" / name / "analysis.json")
    assert found is not None, f"python experiments/report.py results/{name} writes it"
    return found


def crashes(analysis: Analysis, **wanted: str) -> dict[str, str]:
    """The mean effect on the crash rate by term, as it is told."""
    asked = {"arm": "treatment", "against": "control", "scenarios": "own", "scope": "all tasks", **wanted}
    rows = analysis.means[analysis.means["outcome"] == "crashed"]
    for column, value in asked.items():
        rows = rows[rows[column] == value]
    return {row["term"]: difference(row) for row in rows.to_dict("records")}


def test_the_readme_tells_the_numbers_of_the_published_study() -> None:
    study = published("standard")
    shown = [crashes(study, scope="without u-turn")["risky"], crashes(study, arm="dense")["risky"]]
    numbers = [words.replace(" points", "") for words in shown]
    assert [number for number in numbers if number not in told("README.md")] == []


def test_progress_is_told_beside_speed() -> None:
    policies = published("standard").policies
    found = paces(policies[policies["backend"] == "sumo"])
    risky, regular = (
        [f"{found[name][traffic]['progress']:.1f}" for name in ("treatment", "control", "slower")]
        for traffic in ("risky", "regular")
    )
    slower = f"{100 * found['slower']['risky']['crashed']:.0f} %"
    readme = told("README.md")
    assert (
        f"cover {risky[0]} m per second of the time limit (a crash stops them), the others {risky[1]};"
        in readme
    )
    assert f"covers {risky[2]} and crashes in {slower}" in readme
    assert "is {} m/s, that of control agents {}.".format(*risky) in told("docs/study.md")
    assert "it is {}, {} and {} m/s".format(*regular) in told("docs/study.md")


def test_crashes_in_the_last_second_and_unfinished_learning() -> None:
    found = load(ROOT / "results" / "standard")
    treated = [
        frame[
            (frame["kind"] == "agent")
            & (frame["arm"] == "treatment")
            & (frame["traffic"] == "regular")
            & (frame["level"] == 1)
        ]
        for frame in (found.episodes, found.marks)
    ]
    episodes, marks = (
        frame[frame["task"] == task] for frame, task in zip(treated, ("u-turn", "two-way"), strict=True)
    )
    crashes = episodes[episodes["crashed"]]
    late = int((crashes["crash_time"] > 9.0).sum())
    assert f"{late} of {len(crashes)} crashes of treated agents come in the last second" in told("README.md")
    by_mark = [marks[marks["mark"] == mark]["crashed"].mean() for mark in (1, 2)]
    two_way = treated[0][treated[0]["task"] == "two-way"]["crashed"].mean()
    assert f"from {100 * by_mark[1]:.0f} to {100 * two_way:.0f} %" in told("README.md")
    rates = [f"{rate:.2f}".lstrip("0") for rate in (*by_mark, two_way)]
    assert (
        f"from {rates[0]} and {rates[1]} after one and two thirds of the training to {rates[2]} at its end"
        in told("docs/limits.md")
    )


def test_the_studys_page_tells_what_further_arms_do() -> None:
    analysis = published("standard")
    text = section(TEXTS[ROOT / "docs" / "study.md"], "Risk or more interaction?")
    rows = analysis.effects.query("against == 'control' and scenarios == 'own' and outcome == 'crashed'")
    arms = {
        (r["arm"], f"{r['task']} {r['level_name']}", r["term"]): difference(r)
        for r in rows.to_dict("records")
    }
    columns = [(arm, term) for term in ("risky", "regular") for arm in ("dense", "treatment")]
    cells = table(text)
    assert len(cells) == len(TASKS)
    for name, row in cells.items():
        assert [arms[arm, name, term].replace(" points", "") for arm, term in columns] == row
    line = " ".join(text.split())
    means = {arm: crashes(analysis, arm=arm) for arm in ("dose25", "dose50", "dose75", "penalty", "dense")}
    shown = [means[arm][term] for arm in ("dose25", "dose50", "dose75", "penalty") for term in TRAFFICS]
    shown += [means["dense"]["risky"], arms["dose25", "two-way 5+2", "risky"]]
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
        single = effects.query("outcome == 'crashed' and level == 1")
        means = [
            difference(mean_over(single[single["term"] == term], Plan())) for term in ("risky", "regular")
        ]
        gates = analysis.gates.query("level == 1 and arm in ('control', 'treatment')")["passed"].tolist()
        assert shown == [*means, f"{gates.count(True)} of {len(gates)}"], name
