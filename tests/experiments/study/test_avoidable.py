"""The published shares of crashes that could have been avoided are what the documentation says."""

from __future__ import annotations

import pandas as pd
import pytest

from experiments.study.avoid import sample, shares
from experiments.study.store import load
from tests.pages import ROOT, TEXTS, section, table


def test_the_page_tells_the_shares_of_the_stored_crashes() -> None:
    found = shares(pd.read_parquet(ROOT / "results" / "copies" / "avoidable.parquet"))
    rows = {
        f"{task} {level}, {arm}": [str(value) for value in row.drop("agents")]
        for (_, task, level, arm), row in found.iterrows()
    }
    assert table(section(TEXTS[ROOT / "docs" / "collisions.md"], "Could it have been avoided?")) == rows
    assert set(found["agents"]) == {1}


def test_a_share_is_of_the_crashes_with_a_way_out_so_late() -> None:
    crashes = pd.DataFrame({
        "backend": "sumo", "task": "u-turn", "level_name": "3", "arm": "control", "cell": ["a", "a", "b", "b"],
        "contact": [5.5, 6.0, 7.2, 8.0], "last": [5.0, 4.0, 6.1, None], "clear": [5.0, 2.0, 5.0, None],
    })  # fmt: skip
    row = shares(crashes).iloc[0]
    assert [row[name].split()[0] for name in ("1 s", "2 s", "3 s")] == ["25%", "75%", "75%"]
    assert row["3 s"] == "75% [30, 95]"  # Wilson's interval of 3 in 4
    assert row[["agents", "crashes", "until_end"]].tolist() == [2, 4, 1]


@pytest.mark.slow
def test_a_larger_sample_begins_with_the_smaller_and_arms_are_apart() -> None:
    results = load(ROOT / "results" / "standard")
    small, large = (sample(results, count)[["cell", "traffic", "scenario"]] for count in (2, 5))
    pd.testing.assert_frame_equal(small, large.iloc[: len(small)])
    assert large.groupby("cell").size().tolist() == [5] * 10
    assert not large.duplicated().any()
