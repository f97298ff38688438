"""What can be had in each setting and traffic, as `experiments/attainable.py --update` has stored it: marks of returns.

Score 0 is the return of the best constant action, score 1 that of the best driver without foresight and with no more
actions than the agents have; both on scenarios that no report uses.
"""

from collections.abc import Mapping
from functools import cache
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from experiments.support.files import read_json

FILE = Path(__file__).resolve().parents[3] / "results" / "attainable.json"
# What a driver is: one action always, a policy with no more actions than the agents, or one with more.
CONSTANT, POLICY, MORE = "constant", "policy", "more actions"
SEARCH = "search"  # in place of a driver: the best sequences of actions, on the replica


@cache
def stored() -> Mapping[str, Any]:
    """By place (`place`) the drivers by name, each with its kind and mean return, and the search; empty at first."""
    return read_json(FILE) if FILE.exists() else {}


def place(task: str, level_name: str, traffic: str) -> str:
    """What is stored under one key: "two-way 5+2 regular"."""
    return f"{task} {level_name} {traffic}"


def marks(task: str, level_name: str, traffic: str) -> tuple[float, float]:
    """The returns that are score 0 and 1; NaN where nothing is stored, or no policy is above a constant action."""
    low, high = ends(stored().get(place(task, level_name, traffic), {}).get("drivers", {}))
    return (low, high) if low < high else (nan, nan)


def ends(drivers: Mapping[str, Any]) -> tuple[float, float]:
    """The mean returns of the best constant action and of the best policy among drivers of a place; NaN without one."""
    low, high = (
        max((one["return"] for one in drivers.values() if one["kind"] == kind), default=nan)
        for kind in (CONSTANT, POLICY)
    )
    return low, high


def scores(episodes: pd.DataFrame) -> pd.Series:
    """The score of each return; NaN where there are no marks. It may be below 0 and above 1.

    episodes: with task, level_name, traffic and return. The mean of scores is the score of the mean return.
    """
    places = episodes[["task", "level_name", "traffic"]]
    known = {where: marks(*where) for where in places.drop_duplicates().itertuples(index=False, name=None)}
    both = [known[where] for where in places.itertuples(index=False, name=None)]
    low, high = np.array(both, float).reshape(-1, 2).T
    return (episodes["return"] - low) / (high - low)


def undrivable(places: Mapping[str, Any]) -> list[str]:
    """Settings in which most scenarios, of all traffics, have no sequence of actions without a crash that was found.

    places: as stored.
    """
    shares: dict[str, list[float]] = {}
    for name, of in places.items():
        if SEARCH in of:
            shares.setdefault(name.rpartition(" ")[0], []).append(of[SEARCH]["no_safe"])
    return [setting for setting, of in shares.items() if sum(of) > 0.5 * len(of)]
