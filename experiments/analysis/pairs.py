"""Two agents together, held against each of them alone and against other rules, pair by pair.

The unit is the training seed: control agent k, treated agent k, and what both do together. A pair shares its agents
with those that it is held against, so that differences are taken within each seed before they are averaged. Does an
answer hang on one unit? `influence` asks every bound of a plan about pairs without one pair of agents in turn.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pandas as pd

from experiments.analysis.claims import price
from experiments.analysis.effects import ALL_TASKS, contrasts
from experiments.analysis.plan import Plan
from experiments.analysis.scores import arms_of, at_home, once_each
from experiments.study.design.arms import ARMS, PAIRS, REGISTERED
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING

# What is compared, as (pair, against).
COMPARED = [
    *((name, arm) for name in PAIRS for arm in ARMS),
    *((REGISTERED, name) for name in PAIRS if name != REGISTERED),
]
LEFT = ("task", "level_name", "seed")


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


def influence(episodes: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """The plan's bounds over all lightest settings without one pair: looked at afterwards, so no answer by itself.

    Args:
        episodes: as from `scores.with_outcomes`.

    Returns:
        The columns of `claims.price`, a row a bound and pair, and left_task, left_level_name and left_seed of the pair
        that is left out, of settings with two pairs or more. Empty where the plan asks nothing of pairs.
    """
    bounds = [bound for bound in plan.price if bound.arm in PAIRS and bound.where == "lightest"]
    asked = {(bound.arm, bound.against): [("crashed", bound.term)] for bound in bounds}
    plan = replace(plan, price=tuple(bounds))
    drives = units(episodes)
    drives = drives[drives["level"] == 1]
    everybody = contrasts(arms_of(drives, ["crashed"]), asked)
    lefts: list[tuple[Any, ...]] = []
    found: list[pd.DataFrame] = []
    for setting, here in drives.groupby(SETTING):
        elsewhere = everybody[everybody[SETTING].ne(list(setting)).any(axis=1)]
        seeds = here["seed"].unique()
        for seed in seeds if len(seeds) > 1 else ():
            others = contrasts(arms_of(here[here["seed"] != seed], ["crashed"]), asked)
            # Each is named as if it were a simulator of its own, so that all are averaged at once.
            found.append(pd.concat([elsewhere, others]).assign(backend=str(len(lefts))))
            lefts.append((*setting, seed))
    if not (asked and found):
        return pd.DataFrame()
    rows = price(pd.concat(found, ignore_index=True), plan)
    rows = rows[rows["scope"] == ALL_TASKS]
    left = pd.DataFrame([lefts[int(number)] for number in rows["backend"]], rows.index, [*SETTING, "seed"])
    rows = rows.assign(backend=left["backend"], **{f"left_{name}": left[name] for name in LEFT})
    return rows.reset_index(drop=True)
