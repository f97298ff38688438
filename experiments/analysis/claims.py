"""What the effects say about each claim; decided by tests that the plan names, not by eye."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.effects import means
from experiments.analysis.estimate import OK
from experiments.analysis.plan import ALPHA, DEFAULT, OUTCOMES, Bound, Plan
from experiments.study.design.sheet import GRID
from experiments.study.design.traffic import TRAFFICS

HOLDS, CONTRADICTED, NOT_DECIDED = "holds", "contradicted", "not decided"
EQUIVALENT = "equivalent"
ENDS = {"lightest": 0, "densest": -1}  # of a task's settings, by the words of a `Bound`
BESIDE = ["speed_arm", "speed_against", "return_arm", "return_against"]


@dataclass(frozen=True)
class Claim:
    """A statement about every task (and level); its words are in the report's templates.

    The first three are the paper's own. quantity: a term of the effect in each setting, "effect" (the slope of the sum
    over traffic), "mean" (the outcome's slope) or "equivalent" (no difference as large as the margin, in regular
    traffic). sign: what the quantity has to be everywhere.
    """

    name: str
    quantity: str
    outcome: str
    sign: int


CLAIMS = (
    Claim("return rises", "sum", "return", +1),
    Claim("return effect grows", "effect", "return", +1),
    Claim("return falls with traffic", "mean", "return", -1),
    Claim("fewer crashes", "risky", "crashed", -1),
    Claim("crash effect grows", "effect", "crashed", -1),
    Claim("crashes rise with traffic", "mean", "crashed", +1),
    Claim("little harm", EQUIVALENT, "crashed", 0),
)
COUNTS = ("verdict", "right", "wrong", "open", "silent", "not_run", "expected", "detectable")


def claims(effects: pd.DataFrame, slopes: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The verdict on every claim.

    A claim about every task and level holds if each place by itself is significantly on the right side (a conjunction
    needs no adjustment), and is contradicted if any is on the wrong side after Holm's adjustment.

    Args:
        effects: of treatment against control, from `effects.adjusted`. slopes: from `effects.slopes`. plan: whose
            settings the claims are about; others do not count.

    Returns:
        A row a backend and claim: the fields of Claim, verdict, and of the places (settings, for slopes tasks) right
        and wrong (on either side after Holm), open, silent (no evidence: one seed, nothing varies, everybody crashes,
        missing levels), not_run, expected, and detectable (the median over those that are open).
    """
    asked, trends = effects[plan.covers(effects)], slopes[slopes["task"].isin([*plan.tasks])]
    rows = [
        {"backend": backend, **vars(claim)}
        | _counts(claim, asked[asked["backend"] == backend], trends[trends["backend"] == backend], plan)
        for backend in effects["backend"].unique()
        for claim in CLAIMS
    ]
    return pd.DataFrame(rows, columns=["backend", *(field.name for field in fields(Claim)), *COUNTS])


def primary(means: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """The plan's primary question: its outcome by task, treatment minus control, in either traffic.

    Args:
        means: from `effects.means`.

    Returns:
        A row a backend, task (scope) and traffic (term): the columns of `means`, p_adjusted (Holm over the rows of a
        backend) and verdict: "less", "more" or "open".
    """
    rows = means[(means["arm"] == "treatment") & (means["against"] == "control")]
    rows = rows[rows["scope"].isin(plan.tasks) & rows["term"].isin(TRAFFICS)]
    rows = rows[rows["outcome"] == plan.primary_outcome]
    adjusted = rows.groupby("backend")["p"].transform(estimate.adjusted)
    side = np.select([~(adjusted < ALPHA), rows["estimate"] < 0], ["open", "less"], "more")
    return rows.assign(p_adjusted=adjusted, verdict=side).reset_index(drop=True)


def price(effects: pd.DataFrame, plan: Plan) -> pd.DataFrame:
    """Gain without price: every bound of the plan's, in the lightest or densest of its settings, and what it costs.

    Args:
        effects: from `effects.contrasts`.

    Returns:
        A row a backend, bound and scope (a task, "all tasks"): the fields of Bound, settings, estimate, low and high
        (the limits of one-sided tests at alpha each), verdict (contradicted: the whole interval is beyond the margin),
        detectable: the margin that would be kept to with the plan's power if there were no difference; speed_arm and
        speed_against [m/s], slow (see `Plan`), return_arm and return_against (NaN over tasks).
    """
    effects = effects[plan.covers(effects)]
    ends = {(task, names[at]): where for task, names in GRID.items() for where, at in ENDS.items()}
    places = zip(effects["task"], effects["level_name"], strict=True)
    where = pd.Series([ends.get(place, "") for place in places], effects.index, "str")
    effects = effects.assign(where=where)  # text, also without a row
    columns = [field.name for field in fields(Bound)]
    bounds = pd.DataFrame(plan.price, columns=columns)
    asked = effects.merge(bounds)
    # Each end is averaged by itself, as if it were a simulator.
    parts = [means(rows, plan).assign(where=where) for where, rows in asked.groupby("where")]
    found = pd.concat([means(asked.iloc[:0], plan).assign(where=""), *parts])
    key = ["backend", "scope", "arm", "against", "term", "where"]
    rows = bounds.merge(found[found["outcome"] == "crashed"])
    for name, outcome in (("speed", "mean_speed"), ("return", "return")):
        beside = found.loc[found["outcome"] == outcome, [*key, "mean_arm", "mean_against"]]
        names = {"mean_arm": f"{name}_arm", "mean_against": f"{name}_against"}
        rows = rows.merge(beside.rename(columns=names), "left", on=key)
    half = estimate.stats.t.isf(ALPHA, rows["df"]) * rows["se"]  # one-sided
    low, high = rows["estimate"] - half, rows["estimate"] + half
    verdict = np.select([high < rows["margin"], low > rows["margin"]], [HOLDS, CONTRADICTED], NOT_DECIDED)
    enough = [estimate.detectable(se, df, 2 * ALPHA) for se, df in zip(rows["se"], rows["df"], strict=True)]
    slow = rows["speed_arm"] < plan.slow * rows["speed_against"]
    rows = rows.assign(low=low, high=high, verdict=verdict, detectable=enough, slow=slow)
    order = ["backend", "scope", "settings", "estimate", *columns, "low", "high", "verdict", "detectable"]
    return rows[[*order, *BESIDE, "slow"]]


def _counts(claim: Claim, effects: pd.DataFrame, slopes: pd.DataFrame, plan: Plan) -> dict[str, object]:
    is_slope = claim.quantity in ("effect", "mean")
    term = "regular" if claim.quantity == EQUIVALENT else claim.quantity
    table, question = (slopes, slopes["quantity"]) if is_slope else (effects, effects["term"])
    rows = table[(table["outcome"] == claim.outcome) & (question == term)]
    known = rows[(rows["status"] == OK) & (rows["complete"] if is_slope else True)]
    if claim.quantity == EQUIVALENT:
        p = estimate.equivalence(known, OUTCOMES[claim.outcome].margin or 0.0)
        right, alone = estimate.adjusted(p) < ALPHA, p < ALPHA
        wrong = estimate.adjusted(1 - p) < ALPHA / 2
    else:
        better = known["estimate"] * claim.sign > 0
        decided = known["p_adjusted"] < ALPHA
        right, wrong, alone = better & decided, ~better & decided, better & (known["p"] < ALPHA)
    expected = len(plan.tasks if is_slope else plan.settings)
    holds = len(known) > 0 and int(alone.sum()) >= expected
    open_ = known[~(right | wrong)]
    return {
        "verdict": CONTRADICTED if wrong.any() else HOLDS if holds else NOT_DECIDED,
        "right": int(right.sum()),
        "wrong": int(wrong.sum()),
        "open": len(open_),
        "silent": len(rows) - len(known),
        "not_run": max(0, expected - len(rows)),
        "expected": expected,
        "detectable": open_["detectable"].median() if "detectable" in open_ else float("nan"),
    }
