"""The published shares of crashes that could have been avoided are what the documentation says."""

from __future__ import annotations

import pandas as pd

from experiments.study.avoid import SAFE
from experiments.study.evaluate import share
from tests.pages import ROOT, TEXTS, section, table


def test_the_page_tells_the_shares_of_the_stored_crashes() -> None:
    """`last`: the last moment from which the crash can be avoided; `clear`: for how long there is no contact then."""
    stored = pd.read_parquet(ROOT / "results" / "copies" / "avoidable.parquet")
    rows = {}
    for (task, level, arm), crashes in stored.groupby(["task", "level_name", "arm"]):
        margin = crashes["contact"] - crashes["last"]
        late = [share(margin <= seconds).strip() for seconds in (1, 2, 3)]
        rows[f"{task} {level}, {arm}"] = [str(len(crashes)), *late, str((crashes["clear"] < SAFE).sum())]
        assert crashes["cell"].nunique() == 1
    assert table(section(TEXTS[ROOT / "docs" / "collisions.md"], "Could it have been avoided?")) == rows
