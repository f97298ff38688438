"""The average treatment effect of every setting, and the one place where settings are averaged.

The paper's ATE is a sum: (T - C) in risky traffic plus (T - C) in regular traffic. It is computed for each trained
agent first (risky + regular) and then compared between the arms, like its two terms and their interaction. Agents that
fail a gate count as the others do: an agent that did not learn is an outcome of its training.

Frames: `contrasts` has a row an effect, `means` a row a mean over settings, `slopes` a row a task. All share the
columns of an estimate: estimate, se, df, low, high (95 % interval, in the unit of the outcome), p (two-sided) and
status ("ok", or why there is no interval, see `estimate`). Further means are made of the columns of WORKING_COLUMNS.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.analysis import estimate
from experiments.analysis.comparable import comparable
from experiments.analysis.estimate import OK, SATURATED, Estimate, Mean
from experiments.analysis.plan import ALPHA, DEFAULT, OUTCOMES, TERMS, Outcome, Plan
from experiments.analysis.scores import Arms, Setting, at_home
from experiments.study.design.arms import EVERY_ARM
from experiments.study.design.traffic import TRAFFICS
from experiments.study.results.loaded import SETTING, Results

ALL_TASKS = "all tasks"
ESTIMATE = list(Estimate._fields)
COMPARISON = ["backend", "arm", "against"]
QUESTION = ["outcome", "term"]
KEY = [*COMPARISON, "task", "level", "level_name", *QUESTION]
SIGNS = {"treatment": 1.0, "control": -1.0}  # of the arms in an effect
MEANS = ["mean_arm", "mean_against", "seeds_arm", "seeds_against"]
SHARES = ("crashed", "hard_crash", "entered")  # of episodes, so that their means have a least variance
WORKING_COLUMNS = ["variance", "dof", "smallest"]
WEIGHTS = {term: [own.get(traffic, 0.0) for traffic in TRAFFICS] for term, own in TERMS.items()}
TYPES = {
    **dict.fromkeys(("estimate", "mean_arm", "mean_against", "variance", "dof"), "float64"),
    **dict.fromkeys(("level", "seeds_arm", "seeds_against", "smallest"), "int64"),
}


def contrasts(
    arms: Mapping[Setting, Arms],
    asked: Mapping[tuple[str, str], Iterable[tuple[str, str]]],
    signs: tuple[float, float] = (1.0, -1.0),
    terms: Mapping[str, Sequence[float]] = WEIGHTS,
) -> pd.DataFrame:
    """Effects: one arm minus another, or minus a policy that has no training, in every setting that has both.

    Args:
        arms: from `scores.arms_of`. asked: (outcome, term) by (arm, against); outcomes that a setting does not have
            are left out. signs: of the two arms in the sum. terms: weights of the arms' traffics.

    Returns:
        A row an effect: KEY, ESTIMATE, mean_arm and mean_against, seeds_arm and seeds_against, and WORKING_COLUMNS.
    """
    rows = [
        dict(zip(SETTING, setting, strict=True))
        | {"arm": arm, "against": against, "outcome": outcome, "term": term}
        | _contrast(by_name, arm, against, outcome, np.array(terms[term]), signs)
        for setting, by_name in arms.items()
        for (arm, against), questions in asked.items()
        if {arm, against} <= by_name.keys()
        for outcome, term in questions
        if outcome in by_name[arm]
    ]
    columns = [*KEY, "estimate", *MEANS, *WORKING_COLUMNS, "saturated"]
    # also without a row, or others would take its types
    frame = pd.DataFrame(rows, columns=columns).astype(TYPES)
    frame = estimate.with_intervals(frame)
    frame.loc[frame["saturated"].astype(bool), ESTIMATE[1:]] = [*[np.nan] * 5, SATURATED]
    return frame[[*KEY, *ESTIMATE, *MEANS, *WORKING_COLUMNS]]


def _contrast(
    arms: Arms,
    arm: str,
    against: str,
    outcome: str,
    weights: NDArray[np.float64],
    signs: tuple[float, float],
) -> dict[str, Any]:
    """The `Mean` and MEANS of an arm minus another, or scenario by scenario minus a policy that is not trained."""
    both = arms[arm][outcome], arms[against][outcome]
    scores = [np.tensordot(weights, tables, axes=1) for tables in both]
    tested = [tables[weights != 0] for tables in both]
    floored = against in EVERY_ARM and outcome in SHARES
    floors = [sign**2 * estimate.binomial_floor(table) for table, sign in zip(tested, signs, strict=True)]
    trained = against in EVERY_ARM
    weighted = list(zip(scores, signs, strict=True)) if trained else [(scores[0] - scores[1], 1.0)]
    found = estimate.linear(weighted, sum(floors) if floored else 0.0)
    means = [*(float(table.mean()) for table in scores), *map(len, scores)]
    saturated = floored and all((tables == 1).all() for tables in tested)
    return {**found._asdict(), **dict(zip(MEANS, means, strict=True)), "saturated": saturated}


def between(first: Results, other: Results) -> pd.DataFrame:
    """How another folder's effects on the crash rate differ from a first one's, on the scenarios that both have.

    Returns:
        A row a task, level and traffic (term) in which both have agents of both arms: the columns of `Mean`.
    """
    folders = []
    for results, sign in ((first, -1.0), (other, 1.0)):
        rows = at_home(comparable(results)[0].episodes)
        rows = rows[(rows["kind"] == "agent") & rows["arm"].isin(SIGNS)]
        rows = rows[
            rows["backend"] == rows["backend"].min()
        ]  # of several the one that is first in `contrasts`
        signs = sign * rows["arm"].map(SIGNS)
        folders.append(rows.assign(sign=signs, crashed=rows["crashed"].astype(float)))
    rows = pd.concat(folders)
    found = []
    for place, agents in rows.groupby(["task", "level", "traffic"], sort=False):
        four = agents.pivot(index=["arm", "sign", "seed"], columns="scenario", values="crashed").dropna(
            axis=1
        )
        arms = [(own.to_numpy(), sign) for (_, sign), own in four.groupby(["arm", "sign"])]
        if len(arms) == 4 and four.size and place[2] in TRAFFICS:
            mean = estimate.linear(
                arms, sum(estimate.binomial_floor(scores[np.newaxis]) for scores, _ in arms)
            )
            found.append({**dict(zip(("task", "level", "term"), place, strict=True)), **mean._asdict()})
    return pd.DataFrame(found, columns=["task", "level", "term", *Mean._fields])


def adjusted(effects: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The effects of the plan's comparison with what the number of questions makes of them.

    Adds family (its name, empty where exploratory); p_adjusted (Holm within a family and backend, Benjamini-Hochberg
    over everything else); and in families low_family and high_family (the interval at the level of Holm's first step)
    and detectable (true effect that is found at that level with 80 % power).
    """
    questions = zip(effects["outcome"], effects["term"], strict=True)
    nothing = dict.fromkeys(("p_adjusted", "low_family", "high_family", "detectable"), np.nan)
    names = np.array([plan.family(*question) for question in questions], dtype=object)
    names[~plan.covers(effects)] = ""  # a setting that the plan does not name is exploratory
    effects = effects.assign(family=names, **nothing)
    for (_, family), rows in effects.groupby(["backend", "family"]):
        effects.loc[rows.index, "p_adjusted"] = estimate.adjusted(rows["p"], "holm" if family else "bh")
        tested = rows[rows["status"] == OK]
        if family and len(tested):
            level = ALPHA / len(tested)
            half = estimate.stats.t.isf(level / 2, tested["df"]) * tested["se"]
            found = [
                estimate.detectable(se, df, level) for se, df in zip(tested["se"], tested["df"], strict=True)
            ]
            bounds = {"low_family": tested["estimate"] - half, "high_family": tested["estimate"] + half}
            effects.update(tested.assign(**bounds, detectable=found)[[*bounds, "detectable"]])
    return effects


def means(
    effects: pd.DataFrame,
    plan: Plan = DEFAULT,
    leave_one_out: bool = False,
    outcomes: Mapping[str, Outcome] = OUTCOMES,
) -> pd.DataFrame:
    """Means of effects over the plan's settings: every task counts alike, and in a task every level.

    They are over the levels of each task, and over all tasks if the outcome means the same on every task; or, of such
    outcomes, over all tasks but one (`leave_one_out`), in turn. A task that the plan does not name has a mean of its
    own.

    Args:
        effects: from `contrasts`.

    Returns:
        A row a mean: COMPARISON, scope (a task, "all tasks", "without TASK"), QUESTION, ESTIMATE, MEANS (of the numbers
        of agents the sums), settings (their number) and side: "better" or "worse" for the arm if p is below alpha,
        "open" if not; empty for outcomes of which neither more nor less is better.
    """
    planned = plan.covers(effects)
    effects = effects[planned | ~effects["task"].isin([*plan.tasks])]
    own = effects["task"].isin([*plan.tasks])
    tasks = effects["task"].unique()
    pooled = own & effects["outcome"].isin([name for name, one in outcomes.items() if one.poolable])
    if leave_one_out:
        named = effects.loc[own, "task"].unique()
        scopes = {f"without {task}": pooled & (effects["task"] != task) for task in named if len(named) > 1}
    else:
        scopes = {task: effects["task"] == task for task in tasks} | {ALL_TASKS: pooled}
    nothing = effects.iloc[:0].assign(scope="")
    scoped = [nothing, *(effects[chosen].assign(scope=scope) for scope, chosen in scopes.items())]
    rows = pd.concat(scoped, ignore_index=True)
    by = [*COMPARISON, "scope", *QUESTION]
    frame = estimate.combine(rows, by, estimate.equal_task_weights(rows, by))
    frame = frame[[*by, *ESTIMATE, *MEANS, "settings"]]
    better = frame["outcome"].map({name: one.better for name, one in outcomes.items()}).astype(float)
    is_open, good = ~(frame["p"] < ALPHA).astype(bool), (frame["estimate"] * better > 0).astype(bool)
    return frame.assign(side=np.select([better == 0, is_open, good], ["", "open", "better"], "worse"))


def slopes(arms: Mapping[Setting, Arms], plan: Plan = DEFAULT) -> pd.DataFrame:
    """Change per traffic level within each task, of the effect ("effect", the sum) and of the outcome ("mean").

    "mean" averages over the two test traffics and the two arms. Each level has test scenarios of its own, and their
    variance is in the interval.

    Args:
        arms: from `scores.arms_of`.

    Returns:
        A row a backend, task, outcome ("return", "crashed") and quantity: ESTIMATE, complete (whether all levels of the
        task are there) and p_adjusted (Holm over the tasks).
    """
    # The sum counts two traffics; the mean is of one, and of two arms.
    signs = {"effect": (1.0, -1.0), "mean": (0.25, 0.25)}
    asked = {("treatment", "control"): [(outcome, "sum") for outcome in ("return", "crashed")]}
    sums = [contrasts(arms, asked, sign).assign(quantity=quantity) for quantity, sign in signs.items()]
    rows = pd.concat(sums, ignore_index=True)
    by = ["backend", "task", "outcome", "quantity"]
    rows = rows[rows.groupby(by)["level"].transform("nunique") > 1]
    frame = estimate.combine(rows, by, estimate.slope_weights(rows, by))
    frame["complete"] = frame["settings"] == frame["task"].map(Counter(task for task, _ in plan.settings))
    family = frame.groupby(["backend", "outcome", "quantity"])
    frame["p_adjusted"] = family["p"].transform(estimate.adjusted)
    return frame[[*by, "complete", *ESTIMATE, "p_adjusted"]]
