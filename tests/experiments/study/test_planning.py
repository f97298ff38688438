"""The published table of the planners is what the stored episodes say."""

from __future__ import annotations

import pandas as pd

from experiments.study.grid import env_config
from experiments.study.store import load
from sumo_env.tasks import TASKS
from tests.pages import ROOT, TEXTS, section, table


def test_the_page_tells_what_the_stored_episodes_say() -> None:
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
