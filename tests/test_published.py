"""What the README and the study's page tell of the published results is what the stored results say."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pandas as pd
from experiments.analysis.pooling import ALL_TASKS
from experiments.analysis.wording import difference, place
from experiments.reporting.beside import beside

from experiments.analysis.gates import gates
from experiments.study.arms import EXTRA_ARMS, TRAFFICS
from experiments.study.results import load
from sumo_env.tasks import TASKS
from tests.pages import ROOT, TEXTS, section, table


def told(page: str) -> str:
    """The text of a page in one line."""
    return " ".join(TEXTS[ROOT / page].split())


def test_the_table_of_the_readme_is_that_of_the_results() -> None:
    subprocess.run([sys.executable, ROOT / "docs" / "results_table.py", "--check"], check=True)


def test_the_readme_tells_the_numbers_of_the_published_study() -> None:
    analysis = json.loads((ROOT / "results" / "standard" / "analysis.json").read_text())
    shown = [r for r in analysis["sensitivity"] if r["variant"] == "without u-turn"]
    shown += [
        r for r in further_arms(analysis)
        if (r["arm"], r["scope"], r["term"]) == ("dense", ALL_TASKS, "risky")
    ]  # fmt: skip
    assert len(shown) == 2
    numbers = [difference(r, "crashed").replace(" points", "") for r in shown]
    assert [number for number in numbers if number not in told("README.md")] == []


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
    analysis = json.loads((ROOT / "results" / "standard" / "analysis.json").read_text())
    text = section(TEXTS[ROOT / "docs" / "study.md"], "Risk or more interaction?")
    arms = {(r["arm"], r["scope"], r["term"]): difference(r, "crashed") for r in further_arms(analysis)}
    arms |= {
        ("treatment", place(r), r["term"]): difference(r, "crashed")
        for r in analysis["ate"]
        if r["outcome"] == "crashed"
    }
    columns = [(arm, term) for term in ("risky", "regular") for arm in ("dense", "treatment")]
    rows = table(text)
    assert len(rows) == len(TASKS)
    for name, cells in rows.items():
        assert [arms[arm, name, term].replace(" points", "") for arm, term in columns] == cells
    line = " ".join(text.split())
    over_all = [
        (arm, ALL_TASKS, term) for arm in ("dose25", "dose50", "dose75", "penalty") for term in TRAFFICS
    ]
    shown = [*over_all, ("dense", ALL_TASKS, "risky"), ("dose25", "two-way 5+2", "risky")]
    assert [key for key in shown if arms[key] not in line] == []


def test_the_agents_of_further_arms_pass_the_gates() -> None:
    found = load(ROOT / "results" / "standard")
    cells = {name: cell for name, cell in found.cells.items() if cell["key"]["kind"] in ("agent", "baseline")}
    verdicts = gates(cells, found.gate_episodes[found.gate_episodes["cell"].isin(cells)])
    further = [verdict["passed"] for verdict in verdicts if verdict["arm"] in EXTRA_ARMS]
    assert further == [True] * 120
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


def further_arms(analysis: dict[str, Any]) -> list[dict[str, Any]]:
    """The effects of further arms on the crash rate, against the control."""
    return [
        r for r in analysis["exploratory"]["arms"]
        if (r["against"], r["outcome"]) == ("control", "crashed")
    ]  # fmt: skip


def test_the_studys_page_tells_the_numbers_of_every_folder() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "study.md"], "On highway-env's physics"))
    analyses = {
        f"results/{path.parent.name}": json.loads((path.parent / "analysis.json").read_text())
        for path in (ROOT / "results").glob("*/PUBLISHED.md")
    }
    assert set(rows) == set(analyses)
    study = analyses["results/standard"]
    for name, (_, *shown) in rows.items():
        analysis = analyses[name]
        other = analysis if analysis is not study else analyses["results/replica"]
        [compared] = beside([("the study", study), ("the other", other)])
        means = [compared["tables"][k]["rows"][-1]["effects"][analysis is not study] for k in (0, 1)]
        passed = [gate["passed"] is True for gate in analysis["gates"] if gate["level"] == 1]
        assert shown == [*means, f"{sum(passed)} of {len(passed)}"], name
