"""What the effects say about each claim; decided by tests that the plan names, not by eye."""

from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from experiments.analysis import estimate
from experiments.analysis.estimate import OK
from experiments.analysis.plan import ALPHA, DEFAULT, OUTCOMES, Plan
from experiments.study.design.traffic import TRAFFICS

HOLDS, CONTRADICTED, NOT_DECIDED = "holds", "contradicted", "not decided"
EQUIVALENT = "equivalent"


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
