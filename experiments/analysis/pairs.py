"""Two agents together, held against each of them alone and against other rules, pair by pair.

The unit is the training seed: control agent k, treated agent k, and what both do together. A pair shares its agents
with those that it is held against, so that differences are taken within each seed before they are averaged.
"""

from __future__ import annotations

import pandas as pd

from experiments.analysis.scores import at_home, once_each
from experiments.study.design.arms import ARMS, PAIRS, REGISTERED
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING

# What is compared, as (pair, against).
COMPARED = [
    *((name, arm) for name in PAIRS for arm in ARMS),
    *((REGISTERED, name) for name in PAIRS if name != REGISTERED),
]


def units(episodes: pd.DataFrame) -> pd.DataFrame:
    """The episodes of pairs, and of the agents of these pairs, each alone: of seeds that have all of them.

    Args:
        episodes: as from `scores.with_outcomes`.
    """
    rows = at_home(episodes[episodes["traffic"].isin(TRAFFICS)])
    tests = rows[(rows["kind"] == "test") & rows["arm"].isin(list(PAIRS))]
    agents = rows[(rows["kind"] == "agent") & rows["arm"].isin(ARMS)]
    agents = agents.merge(tests[[*SETTING, "seed"]].drop_duplicates())
    both = once_each(pd.concat([tests, agents], ignore_index=True))
    there = both.groupby([*SETTING, "seed"])["arm"].transform("nunique")
    return both[there == both.groupby(SETTING)["arm"].transform("nunique")].reset_index(drop=True)
