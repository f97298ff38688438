"""The published table of the planners is what the stored episodes say."""

from __future__ import annotations

import pandas as pd

from experiments.study.planning import FILE, study, summary
from tests.pages import ROOT, TEXTS, section, table


def test_the_page_tells_what_the_stored_episodes_say() -> None:
    episodes = pd.read_parquet(FILE)
    drives = episodes.groupby(["task", "traffic", "policy"])["scenario"].apply(sorted)
    scenarios = drives.iloc[0]
    assert len(drives) == 15
    assert all(numbers == scenarios for numbers in drives)
    text = section(TEXTS[ROOT / "docs" / "learner.md"], "Planners")
    assert f"{len(scenarios)} of the agents' test scenarios" in " ".join(text.split())
    found = summary(pd.concat([episodes, study(scenarios)], ignore_index=True))
    rows = {f"{traffic}, {driver}": row.tolist() for (traffic, driver), row in found.iterrows()}
    assert table(text) == rows


def test_a_summary_counts_crashes_and_the_scheduled_time() -> None:
    others = ["highway", "two-way", "roundabout", "intersection"]
    driven = [("u-turn", True, 2.0, 50.0), ("u-turn", False, 4.0, 150.0)]
    driven += [(task, False, 1.0, 0.0) for task in others]
    rows = pd.DataFrame(driven, columns=["task", "crashed", "return", "distance"])
    rows = rows.assign(traffic="risky", policy="planner")
    assert summary(rows).loc[("risky", "planner"), "u-turn"] == "0.50/3.0/10.0"  # of 10 s
