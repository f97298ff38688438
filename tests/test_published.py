"""What the README and the study's page tell of the published results is what the stored results say."""

from __future__ import annotations

import json
from typing import Any

import pandas as pd

from experiments.analysis.gates import gates
from experiments.analysis.pooling import ALL_TASKS
from experiments.analysis.wording import difference, place
from experiments.reporting.beside import beside
from experiments.study.arms import EXTRA_ARMS, TRAFFICS
from experiments.study.results import load
from sumo_env.tasks import TASKS
from tests.pages import ROOT, TEXTS, section, table


def test_the_readme_tells_the_numbers_of_the_published_study() -> None:
    analysis = json.loads((ROOT / "results" / "standard" / "analysis.json").read_text())
    pooled = [r for r in analysis["pooled"] if (r["scope"], r["outcome"]) == ("all tasks", "crashed")]
    elsewhere = [
        r for r in analysis["exploratory"]["transfer"]
        if (r["scope"], r["tested_on"]) == ("all tasks", "highway-env")
    ]  # fmt: skip
    told = [r for r in (*pooled, *elsewhere) if r["term"] in ("risky", "regular")]
    told += [r for r in analysis["sensitivity"] if r["variant"] == "without u-turn"]
    told += [
        r for r in further_arms(analysis)
        if (r["arm"], r["scope"], r["term"]) == ("dense", ALL_TASKS, "risky")
    ]  # fmt: skip
    assert len(told) == 6
    readme = " ".join(TEXTS[ROOT / "README.md"].split())
    assert [difference(r, "crashed") for r in told if difference(r, "crashed") not in readme] == []


def test_the_readme_tells_how_often_the_agents_of_its_film_crash() -> None:
    stored = json.loads((ROOT / "results" / "standard" / "showcase.json").read_text())
    [counts] = [place["counts"] for place in stored["places"] if place["task"] == "u-turn"]
    readme = " ".join(TEXTS[ROOT / "README.md"].split())
    assert f"In {sum(counts.values())} scenarios" in readme
    assert f"this control agent alone crashes in {counts['control']}" in readme
    assert f"this treated agent alone in {counts['treatment']}." in readme


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
    told = " ".join(text.split())
    over_all = [
        (arm, ALL_TASKS, term) for arm in ("dose25", "dose50", "dose75", "penalty") for term in TRAFFICS
    ]
    shown = [*over_all, ("dense", ALL_TASKS, "risky"), ("dose25", "two-way 5+2", "risky")]
    assert [key for key in shown if arms[key] not in told] == []


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
    text = section(TEXTS[ROOT / "docs" / "study.md"], "The published study")
    told = table(text[text.index("Treatment minus control") :])
    folders = sorted(path.parent for path in (ROOT / "results").glob("*/PUBLISHED.md"))
    assert set(told) <= set(table(text)) == {f"results/{folder.name}" for folder in folders}
    analyses = {
        f"results/{folder.name}": json.loads((folder / "analysis.json").read_text()) for folder in folders
    }
    study = analyses["results/standard"]
    for name, row in told.items():
        analysis = analyses[name]
        other = analysis if analysis is not study else analyses["results/replica"]
        [compared] = beside([("the study", study), ("the other", other)])
        means = [compared["tables"][k]["rows"][-1]["effects"][analysis is not study] for k in (0, 1)]
        passed = [gate["passed"] is True for gate in analysis["gates"] if gate["level"] == 1]
        assert row == [*means, f"{sum(passed)} of {len(passed)}"], name
        assert means[0] in " ".join(TEXTS[ROOT / "README.md"].split()), name
