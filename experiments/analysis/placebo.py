"""Comparisons whose truth is known to be "no effect": control against control, and a rule against itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import pandas as pd
from scipy.stats import binomtest

from experiments.analysis import statistics
from experiments.analysis.effects import Record, as_record, contrast, effects
from experiments.analysis.plan import DEFAULT, OUTCOMES, TERMS, Plan
from experiments.analysis.pooling import balanced
from experiments.analysis.statistics import OK
from experiments.analysis.tables import CONFIRMATORY, Arm, Pair, Place, settings
from experiments.study.arms import ARMS


def false_arms(pairs: Mapping[Place, Pair]) -> dict[Place, Pair]:
    """The control agents of each setting, dealt alternately into two arms; settings with fewer than four are left."""
    result: dict[Place, Pair] = {}
    for place, pair in pairs.items():
        control = pair["control"]
        if len(control.seeds) >= 4:
            first = [number % 2 == 0 for number in range(len(control.seeds))]
            result[place] = {
                "control": control.only(first),
                "treatment": control.only([not kept for kept in first]),
            }
    return result


def placebo(pairs: Mapping[Place, Pair], plan: Plan = DEFAULT) -> list[Record]:
    """The same analysis of control against control; about 5 % of the comparisons should come out "significant".

    Returns:
        A record a backend and confirmatory outcome: comparisons, rejected, p (of so many rejections or more if 5 % are
        expected), primary (estimate of the plan's primary question, None if this is not its outcome), cells.
    """
    dealt = false_arms(pairs)
    single = replace(plan, looks=())  # half the seeds: the planned looks do not apply
    records = effects(dealt, plan=single, outcomes=CONFIRMATORY, terms=("sum",))
    result = []
    for backend in dict.fromkeys(record["backend"] for record in records):
        for outcome in CONFIRMATORY:
            own = [r for r in records if (r["backend"], r["outcome"], r["status"]) == (backend, outcome, OK)]
            if own:
                rejected = sum(record["p"] < plan.alpha for record in own)
                p = float(binomtest(rejected, len(own), plan.alpha, alternative="greater").pvalue)
                group = {place: pair for place, pair in dealt.items() if place[0] == backend}
                mean = statistics.interval(balanced(group, outcome, plan.primary_term))
                cells = sorted({cell for record in own for cell in record["cells"]})
                result.append(
                    {
                        "backend": backend,
                        "outcome": outcome,
                        "comparisons": len(own),
                        "rejected": rejected,
                        "p": p,
                    }
                    | {
                        "primary": as_record(mean) if outcome == plan.primary_outcome else None,
                        "cells": cells,
                    }
                )
    return result


def negative_control(episodes: pd.DataFrame, policy: str = "careful") -> Record | None:
    """A rule driver as both arms: it has no training, so every "effect" has to be exactly 0, by any weights and signs.

    Args:
        episodes: as from `tables.with_outcomes`.

    Returns:
        policy, comparisons, largest (absolute effect of any setting, outcome and term). None if the rule was not run.
    """
    rule = episodes[episodes["policy"] == policy]
    if rule.empty:
        return None
    twice = [rule.assign(kind="agent", seed=0, arm=arm, cell=rule["cell"] + f" {arm}") for arm in ARMS]
    pairs = settings(pd.concat(twice, ignore_index=True))
    values = [contrast(pair, o, t).value for pair in pairs.values() for o in OUTCOMES for t in TERMS]
    return {
        "policy": policy,
        "comparisons": len(pairs),
        "largest": max((abs(value) for value in values if value is not None), default=0.0),
    }


def planted(pair: Pair, outcome: str, effect: float, traffic: int = 1) -> dict[str, Arm]:
    """A setting whose treated agents have this much more of an outcome in a traffic: a positive control."""
    arm = pair["treatment"]
    values: dict[str, Any] = dict(arm.values)
    values[outcome] = values[outcome].copy()
    values[outcome][traffic] += effect
    return {**pair, "treatment": Arm(arm.seeds, arm.cells, values)}
