"""Comparisons whose truth is known to be "no effect": control against control, and a rule against itself."""

from __future__ import annotations

from dataclasses import replace

import pandas as pd
from scipy.stats import binomtest

from experiments.analysis.effects import contrasts, mean_over
from experiments.analysis.estimate import OK
from experiments.analysis.plan import DEFAULT, OUTCOMES, TERMS, Plan
from experiments.analysis.scores import PLACE, arms_of
from experiments.study.arms import ARMS

LEAST = 4  # control agents of a setting that can be dealt into two arms
PAIR = [("treatment", "control")]


def placebo(episodes: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The same analysis between two halves of the control agents; about 5 % of the effects should be "significant".

    Returns:
        A row a backend and outcome: comparisons, rejected (with p below alpha), p (of so many rejections or more if 5 %
        are expected) and the mean over settings of the plan's primary term: estimate, low, high.
    """
    control = episodes[episodes["arm"] == "control"]
    number = control.groupby(PLACE)["seed"].transform(lambda seeds: seeds.rank(method="dense") - 1)
    halves = control.assign(arm=(number % 2).map({0.0: "control", 1.0: "treatment"}))
    enough = number.groupby([control[column] for column in PLACE]).transform("max") >= LEAST - 1
    single = replace(plan, looks=())  # half the seeds: the planned looks do not apply
    questions = [(outcome, term) for outcome in ("return", "crashed") for term in ("sum", plan.primary_term)]
    effects = contrasts(arms_of(halves[enough], ["return", "crashed"]), PAIR, questions, single)
    rows = []
    for (backend, outcome), own in effects.groupby(["backend", "outcome"], sort=False):
        known = own[(own["term"] == "sum") & (own["status"] == OK)]
        if known.empty:
            continue
        rejected = int((known["p"] < plan.alpha).sum())
        p = binomtest(rejected, len(known), plan.alpha, alternative="greater").pvalue
        found = mean_over(own[own["term"] == plan.primary_term], single)
        rows.append(
            {"backend": backend, "outcome": outcome, "comparisons": len(known), "rejected": rejected, "p": p}
            | {name: found[name] for name in ("estimate", "low", "high")}
        )
    columns = ["backend", "outcome", "comparisons", "rejected", "p", "estimate", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def negative_control(episodes: pd.DataFrame, policy: str = "careful") -> float | None:
    """The largest effect of a rule driver taken as both arms, which has to be 0; None if the rule was not run."""
    rule = episodes[(episodes["policy"] == policy) & (episodes["kind"] == "baseline")]
    if rule.empty:
        return None
    twice = pd.concat([rule.assign(seed=0, arm=arm) for arm in ARMS], ignore_index=True)
    questions = [(outcome, term) for outcome in OUTCOMES for term in TERMS]
    return float(contrasts(arms_of(twice, list(OUTCOMES)), PAIR, questions)["estimate"].abs().max())
