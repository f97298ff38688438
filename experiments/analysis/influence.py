"""Does an answer hang on one unit? Every bound of a plan about pairs, without one pair of agents in turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pandas as pd

from experiments.analysis import pairs
from experiments.analysis.claims import price
from experiments.analysis.effects import ALL_TASKS, contrasts
from experiments.analysis.plan import Plan
from experiments.analysis.scores import arms_of
from experiments.study.design.arms import PAIRS
from experiments.study.results.loaded import SETTING

LEFT = ("task", "level_name", "seed")


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
    units = pairs.units(episodes) if asked else pd.DataFrame()
    units = units[units["level"] == 1] if len(units) else units
    if units.empty:
        return pd.DataFrame()
    everybody = contrasts(arms_of(units, ["crashed"]), asked)
    lefts: list[tuple[Any, ...]] = []
    found: list[pd.DataFrame] = []
    for setting, here in units.groupby(SETTING):
        elsewhere = everybody[everybody[SETTING].ne(list(setting)).any(axis=1)]
        seeds = here["seed"].unique()
        for seed in seeds if len(seeds) > 1 else ():
            others = contrasts(arms_of(here[here["seed"] != seed], ["crashed"]), asked)
            # Each is named as if it were a simulator of its own, so that all are averaged at once.
            found.append(pd.concat([elsewhere, others]).assign(backend=str(len(lefts))))
            lefts.append((*setting, seed))
    if not found:
        return pd.DataFrame()
    rows = price(pd.concat(found, ignore_index=True), plan)
    rows = rows[rows["scope"] == ALL_TASKS]
    left = pd.DataFrame([lefts[int(number)] for number in rows["backend"]], rows.index, [*SETTING, "seed"])
    rows = rows.assign(backend=left["backend"], **{f"left_{name}": left[name] for name in LEFT})
    return rows.reset_index(drop=True)
