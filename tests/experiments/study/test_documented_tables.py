"""Tables of the documentation that are what stored episodes say: learners, planners, avoidable crashes."""

from __future__ import annotations

import pandas as pd
import pytest

from experiments.analysis.plan import SECOND
from experiments.learners import MEASURES, OURS, RL_AGENTS, STABLE_BASELINES, TRAININGS, Options
from experiments.study.design.grid import env_config
from experiments.study.replaying.avoid import SAFE
from experiments.study.results.store import load
from experiments.test import share
from sumo_env.tasks import TASKS
from tests.pages import ROOT, TEXTS, section, table

PAGE = TEXTS[ROOT / "docs" / "developers" / "learner_choice.md"]
CHECKED = {  # row -> task and variant
    "two-way 5+2": ("two-way", "second"),
    "highway 50": ("highway", "second"),
    "intersection 10": ("intersection", "second"),
    "u-turn 3, 13 s": ("u-turn", "second-no-time"),
    "u-turn 3, 13 s, time observed": ("u-turn", "second"),
    "roundabout 5, 15 s": ("roundabout", "second-no-time"),
    "roundabout 5, 15 s, time observed": ("roundabout", "second"),
    "roundabout 5, first version's clock": ("roundabout", "second-first-clock"),
}


def trainings(*seeds: int) -> pd.DataFrame:
    """Return at the end, its change over the last quarter, in units of the range, and the largest Q-value / bound."""
    runs = pd.read_parquet(ROOT / "results" / "choice" / "runs.parquet").query("seed in @seeds")
    runs["value"] = runs["return"] / runs["task"].map(SECOND.learner.ranges)
    by = ["task", "variant", "arm", "seed"]
    found = runs.pivot_table(index=by, columns="share", values="value")
    largest = (runs["largest_q"] / runs["q_bound"]).groupby([runs[name] for name in by]).max()
    return pd.DataFrame({"return": found[1.0], "change": found[1.0] - found[0.75], "largest": largest})


def told(title: str) -> dict[str, list[float]]:
    return {
        name: [float(cell.strip("*")) for cell in cells if cell]
        for name, cells in table(section(PAGE, title)).items()
    }


def test_the_variants_are_told_as_they_were_stored() -> None:
    shown = told("Outcome: one update per step with batch 64, and the longer clock")
    found = trainings(900, 901).groupby(["task", "variant"]).agg({"return": "mean", "largest": "max"})
    assert set(shown) == set(found.index.unique("variant"))
    for name, numbers in shown.items():
        rows = [found.loc[task, name] for task in ("two-way", "u-turn") if (task, name) in found.index]
        expected = [value for row in rows for value in row]
        tolerances = [0.0005, 0.005] * len(rows)  # of the digits that are told
        for number, value, tolerance in zip(numbers, expected, tolerances, strict=True):
            assert number == pytest.approx(value, abs=tolerance + 1e-9), name


def test_the_check_is_told_as_it_was_stored() -> None:
    shown = told("Check of the chosen learner (commits e12af3a, c147a6c and 0b9324b, seed 905)")
    assert set(shown) == set(CHECKED)
    found = trainings(905).droplevel("seed")
    for label, name in CHECKED.items():
        arms = found.loc[name].loc[["control", "treatment"]]
        assert shown[label][:4] == pytest.approx([*arms["return"], *arms["change"]], abs=0.0005 + 1e-9), label
        assert shown[label][4] == pytest.approx(arms["largest"].max(), abs=0.005 + 1e-9), label


def test_the_planners_are_told_as_they_were_stored() -> None:
    """Crash rate / return / distance per scheduled second, beside the study's agents in the same scenarios."""
    planned = pd.read_parquet(ROOT / "results" / "copies" / "planners.parquet")
    drives = planned.groupby(["task", "traffic", "policy"])["scenario"].apply(sorted)
    scenarios = drives.iloc[0]
    assert len(drives) == 15
    assert all(numbers == scenarios for numbers in drives)
    text = section(TEXTS[ROOT / "docs" / "learner.md"], "Planners")
    assert f"{len(scenarios)} of the agents' test scenarios" in " ".join(text.split())

    study = load(ROOT / "results" / "standard").episodes
    study = study[(study["level"] == 1) & study["scenario"].isin(scenarios)]
    study = study.assign(policy=study["arm"].where(study["kind"] == "agent", study["policy"]))
    study = study[study["policy"].isin(["careful", "control", "treatment"])]
    rows = pd.concat([planned, study], ignore_index=True)
    rows["pace"] = rows["distance"] / rows["task"].map(
        {t: env_config("sumo", t, 1)["duration"] for t in TASKS}
    )
    means = rows.groupby(["traffic", "policy", "task"])[["crashed", "return", "pace"]].mean()
    words = means.apply(lambda m: f"{m['crashed']:.2f}/{m['return']:.1f}/{m['pace']:.1f}", axis=1)
    found = words.unstack("task")[list(TASKS)]
    assert table(text) == {", ".join(row): values.tolist() for row, values in found.iterrows()}


def test_the_other_learners_are_told_as_they_were_stored() -> None:
    """Crash rate / share of the time standing / speed / return, by traffic and learner, means over the trainings."""
    stored = pd.read_parquet(ROOT / "results" / "other-learners" / TRAININGS)
    agents = stored[stored["learner"].isin([*OURS, *STABLE_BASELINES, *RL_AGENTS])]
    groups = agents.groupby(["traffic", "learner", "task"])
    assert (groups["training"].nunique() == Options().seeds).all()
    words = groups[list(MEASURES)].mean().apply(lambda m: "{:.2f}/{:.2f}/{:.1f}/{:.1f}".format(*m), axis=1)
    found = words.unstack("task").reindex(columns=[task for task in TASKS if task in set(agents["task"])])
    shown = table(section(TEXTS[ROOT / "docs" / "learner.md"], "Other learners"))
    assert shown == {", ".join(row): values.tolist() for row, values in found.iterrows()}


def test_the_avoidable_crashes_are_told_as_they_were_stored() -> None:
    """`last`: the last moment from which the crash can be avoided; `clear`: for how long there is no contact then."""
    stored = pd.read_parquet(ROOT / "results" / "copies" / "avoidable.parquet")
    rows = {}
    for (task, level, arm), crashes in stored.groupby(["task", "level_name", "arm"]):
        margin = crashes["contact"] - crashes["last"]
        late = [share(margin <= seconds).strip() for seconds in (1, 2, 3)]
        rows[f"{task} {level}, {arm}"] = [str(len(crashes)), *late, str((crashes["clear"] < SAFE).sum())]
        assert crashes["cell"].nunique() == 1
    assert table(section(TEXTS[ROOT / "docs" / "collisions.md"], "Could it have been avoided?")) == rows
