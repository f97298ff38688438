"""Is an agent worth comparing? Four gates that a trained agent has to pass before its effect means anything.

A learner that diverged behaves like a constant, and a pair of diverged arms gives an effect of exactly 0 that no test
of significance notices. Agents that fail are shown, and the effects they enter are called uninformative. The gates are
judged on scenarios of their own: chosen by the test scenarios, the agents left over would be the lucky ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from agents.training import Q_SLACK
from experiments.analysis.scores import PLACE, in_order
from experiments.study.arms import gate_traffics

CONSTANT = 0.98  # share of the steps with the most common action from which a policy counts as constant
TIED = (
    0.98  # share of the scenarios with the return of one constant policy from which an agent is tied with it
)
ENTERING = 0.5  # share of the scenarios in which a policy has to enter the crossing to count as one that does
CONSTANT_POLICIES = ("idle", "random", "faster", "slower")  # what learning has to be worth more than
# Way [m] from the start to just inside the crossing that a task is about: an ego's length beyond its entry.
CROSSINGS = {"roundabout": 24.5, "intersection": 45.0}

GATES: dict[str, str] = {
    "q_bounded": f"Q-values stay below {Q_SLACK} x max |r| / (1 - gamma) on the probe states",
    "not_constant": f"no action is chosen in {CONSTANT:.0%} or more of the steps, and in less than {TIED:.0%} of the "
    "scenarios the return is that of one and the same constant policy",
    "crosses": f"enters the roundabout or intersection in {ENTERING:.0%} or more of the scenarios of its training "
    "traffic, or has a higher return there than every reference policy that does",
    "beats_constant": "return in its training traffic is above that of the best of idle, random, faster and slower by "
    "more than 2 standard errors",
}
FAILURES: dict[str, str] = {  # what it means to fail, in two or three words
    "q_bounded": "diverged",
    "not_constant": "constant policy",
    "crosses": "does not cross",
    "beats_constant": "not above a constant policy",
}
Verdict = tuple[bool | None, float | None, float | None]  # passed, value, limit; None where there is none
UNKNOWN: Verdict = (None, None, None)
References = Mapping[str, pd.DataFrame]  # the episodes of policies in the same traffic, by name


def _q_bounded(learner: Mapping[str, Any]) -> Verdict:
    curve, largest = learner.get("probe_q") or [], learner.get("q_bound")
    if not curve or largest is None:
        return UNKNOWN
    values, limit = [row[2] for row in curve], Q_SLACK * float(largest)
    if any(value is None or not math.isfinite(value) for value in values):
        return False, None, limit
    return max(values) <= limit, float(max(values)), limit


def _not_constant(own: pd.DataFrame, references: References) -> Verdict:
    counts = own[[column for column in own if str(column).startswith("action_")]].sum()
    share = float(counts.max() / counts.sum())
    ties = [
        float(np.isclose(own["return"] - references[policy]["return"], 0.0, atol=1e-9).mean())
        for policy in CONSTANT_POLICIES
        if policy in references
    ]
    return share < CONSTANT and all(tie < TIED for tie in ties), share, CONSTANT


def _crosses(task: str, own: pd.DataFrame, references: References) -> Verdict:
    """Waiting is a failure only where something that crosses is worth more."""
    if task not in CROSSINGS:
        return True, None, None

    def entering(episodes: pd.DataFrame) -> float:
        return float((episodes["distance"] >= CROSSINGS[task]).mean())

    share = entering(own)
    if share >= ENTERING:
        return True, share, ENTERING
    crossing = [float(rows["return"].mean()) for rows in references.values() if entering(rows) >= ENTERING]
    return (float(own["return"].mean()) > max(crossing) if crossing else None), share, ENTERING


def _beats_constant(own: pd.DataFrame, references: References) -> Verdict:
    """Compared on the same scenarios, so that their noise cancels."""
    value = float(own["return"].mean())
    means = {p: float(references[p]["return"].mean()) for p in CONSTANT_POLICIES if p in references}
    if not means:
        return None, value, None
    best = max(means, key=lambda policy: means[policy])
    difference = (own["return"] - references[best]["return"]).dropna()
    if len(difference) < 2:
        return None, value, None
    distance = 2 * float(difference.std(ddof=1)) / math.sqrt(len(difference))
    centre = float(difference.mean())
    return centre > distance, value, value - centre + distance


def gates(cells: Mapping[str, Mapping[str, Any]], episodes: pd.DataFrame) -> pd.DataFrame:
    """The verdict on every trained agent.

    Args:
        cells: cell.json by name. episodes: the gate episodes of all of them, as in `store.Results`.

    Returns:
        A row an agent: cell, PLACE, arm, seed, passed (False if any gate fails, None if one could not be checked, True
        otherwise), failed (the names of the gates), and for each of GATES "<gate>" (passed), "<gate> value" and "<gate>
        limit" (in the gate's own unit: Q-value, share, share, return).
    """
    tables = {
        name: table.set_index(["traffic", "scenario"]).sort_index()
        for name, table in episodes.groupby("cell", sort=False)
    }
    references: dict[tuple[Any, ...], dict[str, pd.DataFrame]] = {}
    for name, table in tables.items():
        key = cells[name]["key"]
        if key["kind"] != "agent":
            references.setdefault(tuple(key[column] for column in PLACE), {})[key["policy"]] = table
    rows = []
    for name, table in tables.items():
        key = cells[name]["key"]
        traffics = list(gate_traffics(key["arm"]))  # of its training
        if key["kind"] != "agent" or not {*traffics} <= {*table.index.unique("traffic")}:
            continue
        cell, own, policies = (
            cells[name],
            table.loc[traffics],
            references.get(tuple(key[c] for c in PLACE), {}),
        )
        others = {policy: table.loc[traffics] for policy, table in policies.items()}
        found = {
            "q_bounded": _q_bounded(cell.get("learner") or {}),
            "not_constant": _not_constant(own, others),
            "crosses": _crosses(key["task"], own, others),
            "beats_constant": _beats_constant(own, others),
        }
        passed = [verdict[0] for verdict in found.values()]
        failed = " ".join(gate for gate, verdict in found.items() if verdict[0] is False)
        sound = False if False in passed else None if None in passed else True
        numbers = [number for verdict in found.values() for number in verdict]
        rows.append([name, *(key[column] for column in (*PLACE, "arm", "seed")), sound, failed, *numbers])
    parts = [f"{gate}{part}" for gate in GATES for part in ("", " value", " limit")]
    frame = pd.DataFrame(rows, columns=["cell", *PLACE, "arm", "seed", "passed", "failed", *parts])
    return in_order(frame, "backend", "task", "level", "arm", "seed").reset_index(drop=True)


def learnt(gates: pd.DataFrame, share: float) -> set[tuple[str, str, int]]:
    """The settings (backend, task, level) where at least this share of the control agents pass the gates.

    Judged by the control agents alone: that the treatment ruins agents would be its effect.
    """
    control = gates[gates["arm"] == "control"]
    passing = (control["passed"].astype(object) != False).groupby(  # noqa: E712
        [control["backend"], control["task"], control["level"]]
    )
    return {key for key, passed in passing.mean().items() if passed >= share}
