"""Does the primary answer hang on a choice? The same question, answered in other ways; and who needs more seeds."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import statsmodels.api as sm
from statsmodels.tools.sm_exceptions import PerfectSeparationWarning

from experiments.analysis import statistics
from experiments.analysis.effects import Record, as_record, cells_of, contrast, least, paired
from experiments.analysis.plan import DEFAULT, Plan
from experiments.analysis.pooling import Pairs, by_task, task_weights
from experiments.analysis.statistics import OK, Mean
from experiments.analysis.tables import PLACE, Pair

PERMUTATIONS = 2000
MIN_PASSING = (
    2  # agents in each arm of a setting that pass the gates, so that it can be compared without the others
)


def passing(pairs: Pairs, verdicts: Sequence[Mapping[str, Any]]) -> Pairs:
    """The agents that pass the gates, in settings that have enough of them."""
    bad = {verdict["cell"] for verdict in verdicts if verdict["passed"] is False}
    kept = {
        place: {name: arm.only([cell not in bad for cell in arm.cells]) for name, arm in pair.items()}
        for place, pair in pairs.items()
    }
    return {place: pair for place, pair in kept.items() if least(pair) >= MIN_PASSING}


def learnt(pairs: Pairs, verdicts: Sequence[Mapping[str, Any]], plan: Plan = DEFAULT) -> list[Record]:
    """For every setting, whether it was learnt: enough of its control agents pass the gates.

    Judged by the control agents alone: that the treatment ruins agents would be its effect.
    """
    passed = {verdict["cell"]: verdict["passed"] is not False for verdict in verdicts}
    records = []
    for place, pair in pairs.items():
        known = [passed[cell] for cell in pair["control"].cells if cell in passed]
        share = sum(known) / len(known) if known else None
        record = {**dict(zip(PLACE, place, strict=True)), "share": share}
        records.append({**record, "learnt": None if share is None else share >= plan.learnt})
    return records


def sensitivity(
    pairs: Pairs, verdicts: Sequence[Mapping[str, Any]] = (), plan: Plan = DEFAULT
) -> list[Record]:
    """The primary question in other ways, for each backend.

    Returns:
        Records with backend, variant (in words), and the fields of an estimate; settings [used, existing]. With
        several tasks each is left out once. The last ones are of other scales: "odds ratio" is a logarithm.
    """
    result: list[Record] = []
    outcome, term = plan.primary_outcome, plan.primary_term
    for backend in dict.fromkeys(place[0] for place in pairs):
        own = {place: pair for place, pair in pairs.items() if place[0] == backend and least(pair)}
        if not own:
            continue
        sound = passing(own, verdicts)
        taught = {tuple(r[k] for k in PLACE) for r in learnt(own, verdicts, plan) if r["learnt"] is not False}
        only_learnt = {place: pair for place, pair in own.items() if place in taught}
        tasks = by_task(own)
        without = {
            f"without {task}": {place: pair for place, pair in own.items() if place[1] != task}
            for task in (tasks if len(tasks) > 1 else ())
        }
        means = {
            "all agents, tasks alike (primary)": (own, _mean(own, outcome, term)),
            "agents that pass the gates": (sound, _mean(sound, outcome, term)),
            "settings that were learnt": (only_learnt, _mean(only_learnt, outcome, term)),
            "every setting alike": (own, _mean(own, outcome, term, alike=True)),
            "the paper's sum instead of risky traffic": (own, _mean(own, outcome, "sum")),
            "agents paired by training seed": (own, _mean(own, outcome, term, pair_by_seed=True)),
            **{variant: (used, _mean(used, outcome, term)) for variant, used in without.items()},
        }
        for variant, (used, mean) in means.items():
            record = {"backend": backend, "variant": variant, **as_record(statistics.interval(mean))}
            result.append({**record, "settings": [len(used), len(own)], "cells": cells_of(used.values())})
        common = {"backend": backend, "settings": [len(own), len(own)], "cells": cells_of(own.values())}
        result.append({**common, "variant": "permutation of the arms", **_permutation(own, outcome, term)})
        result.append({**common, "variant": "odds ratio (logarithm)", **_odds(own, outcome, term)})
    return result


def _mean(pairs: Pairs, outcome: str, term: str, alike: bool = False, pair_by_seed: bool = False) -> Mean:
    of = paired if pair_by_seed else contrast
    weights = [1 / len(pairs)] * len(pairs) if alike else task_weights(pairs)
    return statistics.combine([of(pair, outcome, term) for pair in pairs.values()], weights)


def _permutation(pairs: Pairs, outcome: str, term: str) -> Record:
    """The arms' labels dealt anew within every setting: needs no distribution, says nothing of other scenarios."""
    random = np.random.default_rng(0)
    total, observed = np.zeros(PERMUTATIONS), 0.0
    for pair, weight in zip(pairs.values(), task_weights(pairs), strict=True):
        t, c = (pair[name].scores(outcome, term).mean(axis=1) for name in ("treatment", "control"))
        observed += weight * (t.mean() - c.mean())
        every = np.broadcast_to(np.concatenate([t, c]), (PERMUTATIONS, len(t) + len(c)))
        dealt = random.permuted(every, axis=1)
        total += weight * (dealt[:, : len(t)].mean(axis=1) - dealt[:, len(t) :].mean(axis=1))
    p = float((1 + (np.abs(total) >= abs(observed) - 1e-12).sum()) / (1 + PERMUTATIONS))
    empty = as_record(statistics.Estimate(observed, None, None, p, None, _seeds(pairs), OK))
    return {**empty, "reason": "a p-value alone"}


def _odds(pairs: Pairs, outcome: str, term: str) -> Record:
    """A binomial regression on the logit with overdispersion between agents (quasi-likelihood), settings as blocks.

    Half a crash and half an episode without are added to every agent, so that arms that never crash have odds. Like the
    permutation it says nothing of other scenarios.
    """
    rows = [
        {"setting": str(place), "treated": float(name == "treatment"), "share": (crashes + 0.5) / (size + 1), "n": size}
        for place, pair in pairs.items()
        for name, arm in pair.items()
        for scores in [arm.scores(outcome, term)]
        for size in [scores.shape[1]]
        for crashes in scores.sum(axis=1)
    ]  # fmt: skip
    table = pd.DataFrame(rows)
    design = pd.get_dummies(table["setting"], dtype=float).assign(treated=table["treated"])
    if len(table) <= design.shape[1]:
        reason = "an interval needs two training seeds in every arm"
        return as_record(
            statistics.Estimate(None, None, None, None, None, _seeds(pairs), statistics.ONE_SEED, reason)
        )
    if table["share"].nunique() == 1:
        reason = "all agents crash alike"
        return as_record(
            statistics.Estimate(0.0, None, None, None, None, _seeds(pairs), statistics.DEGENERATE, reason)
        )
    model = sm.GLM(table["share"], design, family=sm.families.Binomial(), var_weights=table["n"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PerfectSeparationWarning)  # said when all agents have the same share
        found = model.fit(scale="X2", use_t=True)
    low, high = found.conf_int().loc["treated"]
    value, p, se = found.params["treated"], found.pvalues["treated"], found.bse["treated"]
    return as_record(
        statistics.Estimate(
            float(value),
            float(low),
            float(high),
            float(p),
            float(found.df_resid),
            _seeds(pairs),
            OK,
            None,
            float(se),
        )
    )


def _seeds(pairs: Pairs) -> tuple[int, int]:
    t, c = (sum(len(pair[name].seeds) for pair in pairs.values()) for name in ("treatment", "control"))
    return t, c


def second_batch(pairs: Pairs, records: Sequence[Record], plan: Plan) -> list[Record]:
    """Which settings get the next batch of seeds: those that are open and that the batch can decide.

    Returns:
        A record a setting of the "safety" family: place, extend, reason. Empty without planned looks.
    """
    if not plan.looks:
        return []
    last = plan.looks[-1]
    result = []
    for record in records:
        if record["family"] != plan.families[0].name:
            continue
        place = {column: record[column] for column in PLACE}
        pair: Pair = pairs[tuple(place.values())]
        needed = _needed(pair, record, plan)
        if least(pair) >= last.seeds:
            extend, reason = False, "all planned seeds are there"
        elif record["status"] != OK:
            extend, reason = False, record["reason"]
        elif record["p_adjusted"] < plan.alpha:
            extend, reason = False, "decided"
        elif needed is None or needed > last.seeds:
            extend, reason = False, f"{last.seeds} seeds would not decide it"
        else:
            extend, reason = (
                True,
                f"open, and {needed} seeds would decide an effect of this size or of the margin",
            )
        result.append({**place, "extend": extend, "reason": reason})
    return result


def _needed(pair: Pair, record: Record, plan: Plan) -> int | None:
    margin = record.get("margin") or 0.0
    size = max(abs(record["estimate"] or 0.0), margin)
    mean = contrast(pair, record["outcome"], record["term"])
    return statistics.seeds_needed(mean, size, plan.alpha * plan.looks[-1].share, plan.power)
