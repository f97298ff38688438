"""Two agents together, held against other pairs and against single agents, pair by pair.

The unit is the pair of training seeds (k, k + half of the seeds). Pairs of control and treated agents share agents with
pairs of one arm, so that differences are taken within each pair before they are averaged. A single agent of an arm is
"one-ARM": the mean over the two agents of a pair, each driving alone.
"""

from __future__ import annotations

import pandas as pd

from experiments.analysis.scores import SETTING, once_each
from experiments.study.design.arms import PAIRS
from experiments.study.design.traffic import TRAFFICS

SINGLE = ("control", "treatment", "mixed")
# What is compared, as (pair, against): the plan's questions, and what an ensemble and a belief are worth.
COMPARED = [
    *(("belief", name) for name in PAIRS if name != "belief"),
    *((name, f"one-{arm}") for name in ("belief", "half") for arm in SINGLE),
    *(("half", f"two-{arm}") for arm in SINGLE),
    *((f"two-{arm}", f"one-{arm}") for arm in SINGLE),
]


def units(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes of pairs, and of the single agents of these pairs under the arm "one-ARM", in `seed` the first's.

    Args:
        episodes: as from `scores.with_outcomes`.

    Returns:
        A row a SETTING, arm, traffic, seed and scenario with the columns of numbers: of pairs that are complete.
    """
    rows = episodes[episodes["traffic"].isin(TRAFFICS) & (episodes["tested_on"] == episodes["backend"])]
    tests = rows[(rows["kind"] == "test") & rows["arm"].isin(list(PAIRS))]
    agents = rows[(rows["kind"] == "agent") & rows["arm"].isin(SINGLE)]
    agents = agents.merge(tests[SETTING].drop_duplicates(), on=SETTING)
    # Of all settings: in one of them pairs can be missing.
    first, last = tests["seed"].min(), tests["seed"].max()
    second = agents["seed"] > last
    agents = agents.assign(arm="one-" + agents["arm"], seed=agents["seed"] - second * (last - first + 1))
    unit = [*SETTING, "arm", "traffic", "seed", "scenario"]
    trained = rows[rows["kind"] != "baseline"]
    once_each(trained.assign(arm=trained["kind"] + " " + trained["arm"]))
    both = pd.concat([tests, agents], ignore_index=True)
    numbers = both.select_dtypes(["number", "bool"]).columns.difference(unit)
    means = both.groupby(unit, sort=False)[[*numbers]].mean().reset_index()
    size = both.groupby(unit, sort=False).size().to_numpy()
    means = means[size == 1 + means["arm"].str.startswith("one-")]
    there = means.groupby([*SETTING, "seed"])["arm"].transform("nunique")
    return means[there == means.groupby(SETTING)["arm"].transform("nunique")]
