"""Is an agent worth comparing? Four gates that a trained agent has to pass before its effect means anything.

A learner that diverged behaves like a constant, and a pair of diverged arms gives an effect of exactly 0 that
no test of significance notices. Agents that fail are shown, and the effects they enter are called
uninformative.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from experiments.causal.tables import PLACE, place_order
from experiments.study.grid import ARMS, TRAFFICS

Q_SLACK = 1.2  # over the largest value that any policy can have, max |r| / (1 - gamma)
CONSTANT = 0.98  # share of the test steps with the most common action from which a policy counts as constant
STANDING = 0.5  # share of the test steps below 1 m/s from which an agent counts as standing still
CONSTANT_POLICIES = ("idle", "random", "faster", "slower")  # what learning has to be worth more than

GATES: dict[str, str] = {
    "q_bounded": f"Q-values stay below {Q_SLACK} x max |r| / (1 - gamma) on the probe states",
    "not_constant": f"no action is chosen in {CONSTANT:.0%} or more of the test steps",
    "progress": f"stands still in less than {STANDING:.0%} of the test steps",
    "beats_constant": "return in its own training traffic reaches that of the best of idle, random, faster "
    "and slower, up to 2 standard errors",
}
FAILURES: dict[str, str] = {  # what it means to fail, in two or three words
    "q_bounded": "diverged",
    "not_constant": "constant policy",
    "progress": "stands still",
    "beats_constant": "below a constant policy",
}
Gate = dict[str, Any]


def _q_bounded(learner: Mapping[str, Any]) -> Gate:
    curve, largest = learner.get("probe_q") or [], learner.get("q_bound")
    if not curve or largest is None:
        return {"passed": None, "value": None, "limit": None, "note": "no Q-values were recorded"}
    values = [row[2] for row in curve]
    limit = Q_SLACK * float(largest)
    if any(value is None or not math.isfinite(value) for value in values):
        return {"passed": False, "value": None, "limit": limit, "note": "Q-values are no longer finite"}
    return {"passed": max(values) <= limit, "value": float(max(values)), "limit": limit, "note": None}


def _not_constant(episodes: pd.DataFrame) -> Gate:
    counts = episodes[[column for column in episodes if str(column).startswith("action_")]].sum()
    share = float(counts.max() / counts.sum())
    action = str(counts.idxmax()).removeprefix("action_")
    return {"passed": share < CONSTANT, "value": share, "limit": CONSTANT, "note": f"action {action}"}


def _progress(episodes: pd.DataFrame) -> Gate:
    share = float(np.average(episodes["stopped"], weights=episodes["length"]))
    return {"passed": share < STANDING, "value": share, "limit": STANDING, "note": None}


def _beats_constant(own: pd.Series, baselines: Mapping[str, pd.Series]) -> Gate:
    """own, baselines: return by test scenario, in the agent's training traffic."""
    value = float(own.mean())
    if not baselines:
        return {"passed": None, "value": value, "limit": None, "note": "no baselines in this directory"}
    best = max(baselines, key=lambda policy: float(baselines[policy].mean()))
    difference = (own - baselines[best]).dropna()  # the same scenarios, so the noise of the scenarios cancels
    if len(difference) < 2:
        return {"passed": None, "value": value, "limit": None, "note": "no common test scenarios"}
    allowance = 2 * float(difference.std(ddof=1)) / math.sqrt(len(difference))
    missing = [policy for policy in CONSTANT_POLICIES if policy not in baselines]
    note = f"best is {best}" + (f"; {', '.join(missing)} not run" if missing else "")
    return {
        "passed": float(difference.mean()) >= -allowance,
        "value": value,
        "limit": float(baselines[best].mean()) - allowance,
        "note": note,
    }


def gates(cells: Mapping[str, Mapping[str, Any]], episodes: pd.DataFrame) -> list[dict[str, Any]]:
    """The verdict on every trained agent.

    Args:
        cells: cell.json by name.
        episodes: their test episodes and those of the baselines, as in `store.Results`.

    Returns:
        One record an agent: cell, backend, task, level, level_name, arm, seed, passed (False if any gate
        fails, None if one could not be checked, True otherwise), failed (names of the gates), and gates: for
        each of GATES passed, value, limit and a note. Values in the gates' own units: Q-value, share, share,
        return.
    """
    tables = dict(tuple(episodes.groupby("cell", sort=False)))
    baselines: dict[tuple[Any, ...], dict[str, pd.Series]] = {}
    for name, cell in cells.items():
        key = cell["key"]
        if key["policy"] in CONSTANT_POLICIES and name in tables:
            for traffic in TRAFFICS:
                place = (*(key[column] for column in PLACE), traffic)
                baselines.setdefault(place, {})[key["policy"]] = _returns(tables[name], traffic)
    records = []
    for name, cell in cells.items():
        key = cell["key"]
        if key["kind"] != "agent" or name not in tables:
            continue
        own_traffic = next(traffic for traffic, risk in TRAFFICS.items() if risk == ARMS[key["arm"]])
        place = (*(key[column] for column in PLACE), own_traffic)
        found: dict[str, Gate] = {
            "q_bounded": _q_bounded(cell.get("learner") or {}),
            "not_constant": _not_constant(tables[name]),
            "progress": _progress(tables[name]),
            "beats_constant": _beats_constant(_returns(tables[name], own_traffic), baselines.get(place, {})),
        }
        results = [gate["passed"] for gate in found.values()]
        records.append(
            {
                "cell": name,
                **{column: key[column] for column in (*PLACE, "arm", "seed")},
                "passed": False if False in results else None if None in results else True,
                "failed": [gate for gate, result in found.items() if result["passed"] is False],
                "gates": found,
            }
        )
    return sorted(records, key=lambda record: (*place_order(record), record["arm"], record["seed"]))


def _returns(table: pd.DataFrame, traffic: str) -> pd.Series:
    return table[table["traffic"] == traffic].set_index("scenario")["return"]
