"""The average treatment effect of every setting, and the one place where settings are averaged.

The paper's ATE is a sum: (T - C) in risky traffic plus (T - C) in regular traffic. It is computed for each trained
agent first (risky + regular) and then compared between the arms, like its two terms and their interaction. Agents that
fail a gate count as the others do: an agent that did not learn is an outcome of its training.

Frames: `contrasts` has a row an effect, `means` a row a mean over settings, `slopes` a row a task. All share the
columns of an estimate: estimate, se, df, low, high (95 % interval, in the unit of the outcome), p (two-sided, right for
all looks that were held) and status ("ok", or why there is no interval, see `estimate`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.estimate import OK, SATURATED, Estimate, Mean
from experiments.analysis.plan import ALPHA, DEFAULT, OUTCOMES, Plan
from experiments.analysis.scores import PLACE, TASK_ORDER, Arm, Arms, Place
from experiments.study.arms import DOSES
from sumo_env.tasks import TASKS

ALL_TASKS = "all tasks"
ESTIMATE = ["estimate", "se", "df", "low", "high", "p", "status"]
# What is compared: the simulator of the training and that of the test; whose scenarios ("own", or those that agents
# were given on another simulator); the arms.
COMPARISON = ["backend", "tested_on", "scenarios", "arm", "against"]
QUESTION = ["outcome", "term"]
KEY = [*COMPARISON, "task", "level", "level_name", *QUESTION]
MEANS = ["mean_arm", "mean_against", "seeds_arm", "seeds_against"]
GRID = {task: len(definition.levels) for task, definition in TASKS.items()}


def decided(looks: Sequence[Mean], seeds: int, plan: Plan) -> Estimate:
    """The estimate at the last look that was held, with a p-value that is right for all of them.

    The looks share the error rate (Bonferroni), so that it is kept whatever the first look makes one do.

    Args:
        looks: the mean at each planned look; of more than are planned the last, of all agents.
        seeds: in the smaller arm; says which looks were held.
    """
    held = plan.held(seeds)
    found = [estimate.interval(mean) for mean in looks[-len(plan.schedule) :][: len(held)]]
    spent = [one.p / look.share for one, look in zip(found, held, strict=True) if one.status == OK]
    return replace(found[-1], p=min(1.0, *spent)) if found[-1].status == OK else found[-1]


def at_looks(
    pair: Sequence[Arm], signs: Sequence[float], outcome: str, term: str, plan: Plan
) -> tuple[Mean, ...]:
    """The sum of sign x mean over arms at every planned look; one, of all agents, where no look was planned."""
    means = []
    for look in plan.schedule:
        arms = [arm.below(look.seeds) for arm in pair]
        floor = sum(sign**2 * arm.floor(outcome, term) for arm, sign in zip(arms, signs, strict=True))
        scores = [(arm.scores(outcome, term), sign) for arm, sign in zip(arms, signs, strict=True)]
        means.append(estimate.linear(scores, floor))
    return tuple(means)


def contrasts(
    arms: Mapping[Place, Arms],
    asked: Mapping[tuple[str, str], Iterable[tuple[str, str]]],
    plan: Plan = DEFAULT,
    **labels: str,
) -> pd.DataFrame:
    """Effects: one arm minus another, or minus a policy that has no training, in every setting that has both.

    Args:
        arms: from `scores.arms_of`. asked: (outcome, term) by (arm, against).
        labels: tested_on and scenarios, where they are not those of the training.

    Returns:
        A row an effect: KEY, ESTIMATE, mean_arm and mean_against, seeds_arm and seeds_against, and looks (the `Mean` at
        every look, of which `means` and `slopes` are made).
    """
    rows = []
    for place, by_name in arms.items():
        where = {**dict(zip(PLACE, place, strict=True)), "tested_on": place[0], "scenarios": "own", **labels}
        for (arm, against), questions in asked.items():
            if arm in by_name and against in by_name:
                pair, trained = (by_name[arm], by_name[against]), against in DOSES
                rows += [
                    {**where, "arm": arm, "against": against, "outcome": outcome, "term": term}
                    | _contrast(pair, trained, outcome, term, plan)
                    for outcome, term in questions
                ]
    return pd.DataFrame(rows, columns=[*KEY, *ESTIMATE, *MEANS, "looks"])


def _contrast(pair: tuple[Arm, Arm], trained: bool, outcome: str, term: str, plan: Plan) -> dict[str, Any]:
    """ESTIMATE, MEANS and looks of an arm minus another, or scenario by scenario minus a policy that is not trained."""
    scores = [arm.scores(outcome, term) for arm in pair]
    if trained:
        looks = at_looks(pair, (1.0, -1.0), outcome, term, plan)
    else:
        looks = (estimate.linear([(scores[0] - scores[1], 1.0)]),)
    seeds = [len(arm.seeds) for arm in pair]
    found = decided(looks, min(seeds), plan)
    tables = [table for arm in pair for table in arm.tested(outcome, term)]
    if trained and outcome == "crashed" and all((table == 1).all() for table in tables):
        found = Estimate(found.estimate, SATURATED)
    means = [float(table.mean()) for table in scores]
    return {**asdict(found), **dict(zip(MEANS, [*means, *seeds], strict=True)), "looks": looks}


def adjusted(effects: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The effects of the plan's comparison with what the number of questions makes of them.

    Adds family (its name, empty where exploratory); p_adjusted (Holm within a family and backend, Benjamini-Hochberg
    over everything else); and in families low_family and high_family (the interval at the level of Holm's first step)
    and detectable (true effect that is found at that level with 80 % power).
    """
    questions = zip(effects["arm"], effects["outcome"], effects["term"], strict=True)
    names = [plan.family(*question) for question in questions]
    nothing = dict.fromkeys(("p_adjusted", "low_family", "high_family", "detectable"), np.nan)
    effects = effects.assign(family=names, **nothing)
    for (_, family), rows in effects.groupby(["backend", "family"]):
        effects.loc[rows.index, "p_adjusted"] = estimate.adjusted(rows["p"], "holm" if family else "bh")
        tested = rows[rows["status"] == OK]
        for index, row in tested.iterrows() if family else ():
            share = plan.held(min(row["seeds_arm"], row["seeds_against"]))[-1].share
            level = ALPHA / len(tested) * share
            half = float(estimate.stats.t.isf(level / 2, row["df"])) * row["se"]
            found = estimate.detectable(row["se"], row["df"], level)
            bounds = [row["estimate"] - half, row["estimate"] + half, found]
            effects.loc[index, ["low_family", "high_family", "detectable"]] = bounds
    return effects


def mean_over(rows: pd.DataFrame, plan: Plan) -> dict[str, Any]:
    """The mean of effects over settings: every task counts alike, and in a task every level.

    Args:
        rows: effects of one comparison, outcome and term.

    Returns:
        ESTIMATE, the means and numbers of agents of both arms, and settings (their number).
    """
    weights = estimate.alike(list(rows["task"]))
    looks = [estimate.combine(means, weights) for means in zip(*rows["looks"], strict=True)]
    seeds, first = rows[MEANS[2:]].min(axis=1), plan.schedule[0].seeds
    most = int(seeds.max())
    if (seeds < first).any():
        most = min(most, first)  # the first batch is not complete: there is no second look yet
    means = [float((weights * rows[name]).sum()) for name in MEANS[:2]]
    agents = [int(rows[name].sum()) for name in MEANS[2:]]
    found = asdict(decided(looks, most, plan))
    return found | dict(zip(MEANS, [*means, *agents], strict=True)) | {"settings": len(rows)}


def means(effects: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """Means of effects over the levels of each task, and over all tasks if the outcome means the same on every task.

    Returns:
        A row a mean: COMPARISON, scope (a task, "all tasks"), QUESTION, ESTIMATE, MEANS and settings.
    """
    rows = []
    for key, group in effects.groupby([*COMPARISON, *QUESTION], sort=False):
        labels = dict(zip([*COMPARISON, *QUESTION], key, strict=True))
        by_task = {task: own for task in TASK_ORDER if len(own := group[group["task"] == task])}
        whole = {ALL_TASKS: group} if OUTCOMES[labels["outcome"]].poolable else {}
        for scope, own in (by_task | whole).items():
            rows.append({**labels, "scope": scope, **mean_over(own, plan)})
    return pd.DataFrame(rows, columns=[*COMPARISON, "scope", *QUESTION, *ESTIMATE, *MEANS, "settings"])


def leaving_out(effects: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The means over all tasks but one, for each of several tasks: as `means`, scope "without TASK"."""
    found = [means(effects, plan).iloc[:0]]
    for task in effects["task"].unique() if effects["task"].nunique() > 1 else ():
        rows = means(effects[effects["task"] != task], plan)
        found.append(rows[rows["scope"] == ALL_TASKS].assign(scope=f"without {task}"))
    return pd.concat(found, ignore_index=True)


def slopes(arms: Mapping[Place, Arms], plan: Plan = DEFAULT) -> pd.DataFrame:
    """Change per traffic level within each task, of the effect ("effect", the sum) and of the outcome ("mean").

    "mean" averages over the two test traffics and the two arms. Each level has test scenarios of its own, and their
    variance is in the interval.

    Returns:
        A row a backend, task, outcome ("return", "crashed") and quantity: ESTIMATE, complete (whether all levels of the
        task are there) and p_adjusted (Holm over the tasks).
    """
    by_task: dict[tuple[str, str], list[tuple[int, tuple[Arm, Arm]]]] = {}
    for (backend, task, level, _), by_name in arms.items():
        if "treatment" in by_name and "control" in by_name:
            pair = by_name["treatment"], by_name["control"]
            by_task.setdefault((backend, task), []).append((level, pair))
    # The sum counts two traffics; the mean is of one, and of two arms.
    signs = {"effect": (1.0, -1.0), "mean": (0.25, 0.25)}
    rows = []
    for (backend, task), levels in by_task.items():
        if len(levels) < 2:
            continue
        weights = estimate.slope_weights([level for level, _ in levels])
        least = min(len(arm.seeds) for _, pair in levels for arm in pair)
        for outcome in ("return", "crashed"):
            for quantity, sign in signs.items():
                each = [at_looks(pair, sign, outcome, "sum", plan) for _, pair in levels]
                looks = [estimate.combine(found, weights) for found in zip(*each, strict=True)]
                labels = {"backend": backend, "task": task, "outcome": outcome, "quantity": quantity}
                complete = len(levels) == GRID.get(task)
                rows.append({**labels, "complete": complete, **asdict(decided(looks, least, plan))})
    columns = ["backend", "task", "outcome", "quantity", "complete", *ESTIMATE]
    frame = pd.DataFrame(rows, columns=columns).assign(p_adjusted=np.nan)
    for _, family in frame.groupby(["backend", "outcome", "quantity"]):
        frame.loc[family.index, "p_adjusted"] = estimate.adjusted(family["p"])
    return frame
