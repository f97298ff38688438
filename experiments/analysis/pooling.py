"""Effects over several settings: the primary answer, means, heterogeneity, and slopes over traffic."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats
from statsmodels.stats.meta_analysis import combine_effects

from experiments.analysis import statistics
from experiments.analysis.effects import (
    Record,
    adjust,
    as_record,
    below,
    cells_of,
    contrast,
    estimated,
    least,
)
from experiments.analysis.plan import ALPHA, DEFAULT, OUTCOMES, TERMS, Plan
from experiments.analysis.statistics import Mean
from experiments.analysis.tables import CONFIRMATORY, TASK_ORDER, Pair, Place

ALL_TASKS = "all tasks"
Pairs = Mapping[Place, Pair]


def by_task(pairs: Pairs) -> dict[str, dict[Place, Pair]]:
    """The settings with both arms, task by task."""
    result: dict[str, dict[Place, Pair]] = {}
    for place, pair in pairs.items():
        if least(pair):
            result.setdefault(str(place[1]), {})[place] = pair
    return result


def task_weights(places: Iterable[Place]) -> list[float]:
    """Weights of settings with which every task counts alike, and in a task every level."""
    tasks = [place[1] for place in places]
    return [1 / len(set(tasks)) / tasks.count(task) for task in tasks]


def balanced(pairs: Pairs, outcome: str, term: str, seed: int | None = None) -> Mean:
    """The mean effect over settings, every task weighted alike."""
    means = [contrast(below(pair, seed), outcome, term) for pair in pairs.values()]
    return statistics.combine(means, task_weights(pairs))


def random_effects(values: Sequence[float], variances: Sequence[float]) -> Record | None:
    """Mean of a population that these effects are a sample of, with Hartung and Knapp's interval.

    Returns:
        estimate, low, high, p, df, tau (standard deviation between the true effects), i2 (share of the variance that is
        heterogeneity), heterogeneity_p (Cochran's Q), prediction [low, high] (of the effect in another member of the
        population; None with three of them), members. None for fewer than three effects (an interval with one degree of
        freedom says nothing) or one without variance.
    """
    y, v = np.asarray(values, dtype=float), np.asarray(variances, dtype=float)
    if len(y) < 3 or (v <= 0).any():
        return None
    with np.errstate(divide="ignore"):  # of its I-squared where all effects are the same, computed below
        found = combine_effects(y, v, method_re="iterated", use_t=True)
    tau2 = max(float(found.tau2), 0.0)
    weights = 1 / (v + tau2)
    mean = float((weights * y).sum() / weights.sum())
    scale = float((weights * (y - mean) ** 2).sum()) / (len(y) - 1)
    # Never narrower than without the correction (Roever, Knapp and Friede 2015).
    se = float(np.sqrt(max(scale, 1.0) / weights.sum()))
    df = len(y) - 1
    half = float(stats.t.ppf(1 - ALPHA / 2, df)) * se
    wide = float(stats.t.ppf(1 - ALPHA / 2, df - 1)) * float(np.sqrt(tau2 + se**2)) if df > 2 else None
    q = float(found.q)
    return {
        "estimate": mean,
        "low": mean - half,
        "high": mean + half,
        "p": float(2 * stats.t.sf(abs(mean) / se, df)),
        "df": df,
        "tau": tau2**0.5,
        "i2": max(0.0, (q - df) / q) if q > 0 else 0.0,
        "heterogeneity_p": float(stats.chi2.sf(q, df)),
        "prediction": None if wide is None else [mean - wide, mean + wide],
        "members": len(y),
    }


def pooled(pairs: Pairs, plan: Plan = DEFAULT) -> list[Record]:
    """Mean effect over the traffic levels of a task, and over all tasks where the outcome allows it.

    Returns:
        Records as from `effects` with scope (a task or "all tasks"), primary (whether it is the plan's primary
        question) and comparisons [with both arms, existing] instead of task and level; over_tasks and over_settings:
        see `random_effects` (over_settings within a task for the scope of a task).
    """
    result = []
    for backend in dict.fromkeys(place[0] for place in pairs):
        own = {place: pair for place, pair in pairs.items() if place[0] == backend}
        for scope, every in _scopes(own):
            group = {place: pair for place, pair in every.items() if least(pair)}
            for outcome in OUTCOMES:
                if scope == ALL_TASKS and not OUTCOMES[outcome].poolable:
                    continue
                for term in TERMS:
                    record = {"backend": backend, "scope": scope, "outcome": outcome, "term": term}
                    record |= _pooled(group, outcome, term, plan)
                    primary = (scope, outcome, term) == (ALL_TASKS, plan.primary_outcome, plan.primary_term)
                    record |= {"primary": primary, "comparisons": [len(group), len(every)]}
                    result.append({**record, "cells": cells_of(group.values())})
    return result


def _scopes(pairs: Pairs) -> Iterator[tuple[str, Pairs]]:
    tasks = sorted({str(place[1]) for place in pairs}, key=TASK_ORDER.__getitem__)
    for task in tasks:
        yield task, {place: pair for place, pair in pairs.items() if place[1] == task}
    yield ALL_TASKS, pairs


def _pooled(group: Pairs, outcome: str, term: str, plan: Plan) -> Record:
    seeds = max((least(pair) for pair in group.values()), default=0)
    if plan.looks and any(least(pair) < plan.looks[0].seeds for pair in group.values()):
        seeds = min(
            seeds, plan.looks[0].seeds
        )  # the first batch is not complete: there is no second look yet
    found, _, _ = estimated(lambda seed: balanced(group, outcome, term, seed), plan, seeds)
    settings = [contrast(pair, outcome, term) for pair in group.values()]
    tasks = [balanced(levels, outcome, term) for levels in by_task(group).values()]
    return as_record(found) | {"over_settings": _population(settings), "over_tasks": _population(tasks)}


def _population(means: Sequence[Mean]) -> Record | None:
    known = [mean for mean in means if mean.value is not None and mean.least > 1]
    return random_effects([m.value for m in known if m.value is not None], [m.variance for m in known])


def failures(pairs: Pairs, verdicts: Sequence[Mapping[str, Any]], plan: Plan = DEFAULT) -> list[Record]:
    """The share of agents that fail the gates, as an outcome: treatment minus control, every task weighted alike.

    Returns:
        A record a backend and scope: shares [treatment, control], counts [[failed, agents] of each], estimate, low,
        high, p.
    """
    bad = {verdict["cell"] for verdict in verdicts if verdict["passed"] is False}
    result = []
    for backend in dict.fromkeys(place[0] for place in pairs):
        own = {place: pair for place, pair in pairs.items() if place[0] == backend and least(pair)}
        for scope, group in _scopes(own) if own else ():
            means, counts, shares = (
                [],
                {"treatment": [0, 0], "control": [0, 0]},
                {"treatment": 0.0, "control": 0.0},
            )
            for pair, weight in zip(group.values(), task_weights(group), strict=True):
                flags = {n: np.array([[float(c in bad)] for c in arm.cells]) for n, arm in pair.items()}
                floor = statistics.binomial_floor(list(flags.values()))
                arms = [(flags["treatment"], 1.0), (flags["control"], -1.0)]
                means.append(statistics.linear(arms, floor))
                for name, values in flags.items():
                    counts[name] = [counts[name][0] + int(values.sum()), counts[name][1] + len(values)]
                    shares[name] += weight * float(values.mean())
            found = statistics.interval(statistics.combine(means, task_weights(group)))
            record = {"backend": backend, "scope": scope, **as_record(found), "shares": list(shares.values())}
            result.append({**record, "counts": list(counts.values()), "cells": cells_of(group.values())})
    return result


def slopes(pairs: Pairs, grid: Mapping[str, int], plan: Plan = DEFAULT) -> list[Record]:
    """Change per traffic level within each task, of the effect ("effect", the sum) and the outcome ("mean").

    "mean" averages over the two test traffics and the two arms. Each level has test scenarios of its own, and their
    variance is in the interval.

    Args:
        grid: number of traffic levels of each task in the complete grid.

    Returns:
        Records as from `effects` with quantity, levels (their numbers) and complete (whether that is all of them)
        instead of level and term, for the confirmatory outcomes. Holm over the tasks.
    """
    result: list[Record] = []
    for backend in dict.fromkeys(place[0] for place in pairs):
        own = {place: pair for place, pair in pairs.items() if place[0] == backend}
        for outcome in CONFIRMATORY:
            families: dict[str, list[Record]] = {"effect": [], "mean": []}
            for task, by_place in by_task(own).items():
                levels = [int(place[2]) for place in by_place]
                if len(levels) < 2:
                    continue
                for quantity, family in families.items():
                    record = {"backend": backend, "task": task, "outcome": outcome, "quantity": quantity}
                    record |= {"levels": levels, "complete": len(levels) == grid.get(task)}
                    record |= _slope(by_place, levels, outcome, quantity, plan)
                    family.append({**record, "cells": cells_of(by_place.values())})
            for family in families.values():
                adjust(family, "Holm", plan)
                result += family
    return result


def _slope(pairs: Pairs, levels: Sequence[int], outcome: str, quantity: str, plan: Plan) -> Record:
    signs = (
        (1.0, -1.0) if quantity == "effect" else (0.25, 0.25)
    )  # the sum counts two traffics, the mean is of one

    def of(seed: int | None) -> Mean:
        means = []
        for pair in pairs.values():
            arms = [below(pair, seed)[name] for name in ("treatment", "control")]
            weighted = [(arm.scores(outcome, "sum"), sign) for arm, sign in zip(arms, signs, strict=True)]
            floor = signs[0] ** 2 * sum(arm.floor(outcome, "sum") for arm in arms)
            means.append(statistics.linear(weighted, floor))
        return statistics.combine(means, statistics.slope_weights(levels))

    found, _, share = estimated(of, plan, min(least(pair) for pair in pairs.values()))
    return as_record(found) | {"share": share}
