"""What the effects say about each claim; decided by tests that the plan names, not by eye."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy import stats

from experiments.analysis import statistics
from experiments.analysis.effects import Record
from experiments.analysis.plan import DEFAULT, OUTCOMES, Plan
from experiments.analysis.statistics import DEGENERATE, MISSING, OK, ONE_SEED, SATURATED
from experiments.analysis.wording import count, difference, listing, number, place

HOLDS, CONTRADICTED, NOT_DECIDED = "holds", "contradicted", "not decided"
PRIMARY = "primary"  # the outcome that is the plan's primary one on each task


@dataclass(frozen=True)
class Claim:
    """A statement about every task (and level).

    source: "paper" for the paper's own, "crash rate" for what this study asks of crashes.
    short: the claim after "that", in a few words.
    quantity: a term of the effect in each setting, "effect" (the slope of the sum over traffic), "mean" (the
    outcome's slope) or "equivalence" (no difference as large as the margin, in regular traffic).
    sign: what the quantity has to be everywhere; 0 stands for the side that is better.
    """

    text: str
    short: str
    source: str
    quantity: str
    outcome: str
    sign: int = 0


CLAIMS = (
    Claim(
        "Training among risky drivers raises the return, on every task and traffic level",
        "it raises the return everywhere",
        "paper",
        "sum",
        "return",
    ),
    Claim(
        "This effect on the return grows with traffic, on every task",
        "this effect grows with traffic",
        "paper",
        "effect",
        "return",
    ),
    Claim(
        "The return falls as traffic grows, on every task",
        "the return falls as traffic grows",
        "paper",
        "mean",
        "return",
        -1,
    ),
    Claim(
        "Training among risky drivers lowers the crash rate in risky traffic, on "
        "every task and traffic level",
        "it lowers the crash rate in risky traffic everywhere",
        "crash rate",
        "risky",
        PRIMARY,
    ),
    Claim(
        "This effect on crashes grows with traffic, on every task",
        "this effect grows with traffic",
        "crash rate",
        "effect",
        "crashed",
    ),
    Claim(
        "The crash rate rises as traffic grows, on every task",
        "the crash rate rises as traffic grows",
        "crash rate",
        "mean",
        "crashed",
        +1,
    ),
    Claim(
        "It changes the crash rate in regular traffic by less than the margin, on every task and traffic level",
        "it changes little in regular traffic",
        "crash rate",
        "equivalence",
        "crashed",
    ),
)


def claims(
    ate: Sequence[Record], slopes: Sequence[Record], grid: Mapping[str, int], plan: Plan = DEFAULT
) -> list[Record]:
    """The verdict on every claim, for each backend.

    Args:
        ate: from `effects.effects`. slopes: from `pooling.slopes`.
        grid: number of traffic levels of each task in the complete grid; a claim about every task and level
        holds only if none of them is missing.

    Returns:
        Records with claim, short, source, quantity, backend, outcome, verdict ("holds", "contradicted", "not decided"),
        reason, decides (what would decide it, None where nothing is open), counts (see `decide`), cells.
    """
    result = []
    for backend in dict.fromkeys(record["backend"] for record in ate):
        for claim in CLAIMS:
            slope = claim.quantity in ("effect", "mean")
            items = [
                r for r in (slopes if slope else ate) if r["backend"] == backend and _is_about(r, claim, plan)
            ]
            expected = len(grid) if slope else sum(grid.values())
            if claim.quantity == "equivalence":
                verdict, reason, counts = decide_equivalence(items, expected, plan)
            else:
                verdict, reason, counts = decide(items, claim.sign, expected, plan)
            result.append(
                {
                    "claim": claim.text,
                    "short": claim.short,
                    "source": claim.source,
                    "quantity": claim.quantity,
                    "backend": backend,
                    "outcome": claim.outcome,
                    "verdict": verdict,
                    "reason": reason,
                    "decides": _would_decide(items, counts, claim.quantity == "equivalence")
                    if verdict == NOT_DECIDED
                    else None,
                    "counts": counts,
                    "cells": sorted({cell for item in items for cell in item["cells"]}),
                }
            )
    return result


def _is_about(record: Record, claim: Claim, plan: Plan) -> bool:
    outcome = plan.outcome(record["task"]) if claim.outcome == PRIMARY else claim.outcome
    term = "regular" if claim.quantity == "equivalence" else claim.quantity
    return bool((record["outcome"], record.get("term", record.get("quantity"))) == (outcome, term))


def usable(record: Record) -> bool:
    """Whether a record can count for or against: it has an interval, and a slope is over all levels."""
    return bool(record["status"] == OK and record.get("complete", True))


def decide(
    items: Sequence[Record], sign: int, expected: int, plan: Plan = DEFAULT
) -> tuple[str, str, dict[str, int]]:
    """Verdict, reason and counts for "the quantity has this sign in all `expected` places".

    It holds if each place by itself is significantly on the right side (a conjunction needs no adjustment), and is
    contradicted if any is on the wrong side after Holm's adjustment. The counts say how far it goes: right and wrong
    (places on either side after Holm), at_least and wrong_at_least (in so many places at least the effect is on that
    side, with 97.5 % confidence), open, expected and not_run.
    """
    known = [r for r in items if usable(r)]
    sides = [1 if r["estimate"] * (sign or OUTCOMES[r["outcome"]].better) > 0 else -1 for r in known]
    pairs = list(zip(known, sides, strict=True))
    right = [r for r, side in pairs if side > 0 and r["p_adjusted"] < plan.alpha]
    wrong = [r for r, side in pairs if side < 0 and r["p_adjusted"] < plan.alpha]
    alone = sum(side > 0 and r["p"] < plan.alpha for r, side in pairs)
    one_sided = [r["p"] / 2 if side > 0 else 1 - r["p"] / 2 for r, side in pairs]
    counts = {
        "expected": expected,
        "right": len(right),
        "wrong": len(wrong),
        "open": len(known) - len(right) - len(wrong),
        "at_least": statistics.at_least(one_sided, plan.alpha / 2),
        "wrong_at_least": statistics.at_least([1 - p for p in one_sided], plan.alpha / 2),
        "not_run": max(0, expected - sum(r["status"] != MISSING for r in items)),
    }
    more = counts["at_least"] > len(right)
    return _conclude(
        items, known, wrong, alone, counts,
        said=f" one by one, and in {counts['at_least']} at least taken together" if more else "",
        against="the opposite",
        undecided=" (the interval at Holm's level includes 0)",
    )  # fmt: skip


def decide_equivalence(
    items: Sequence[Record], expected: int, plan: Plan = DEFAULT
) -> tuple[str, str, dict[str, int]]:
    """The same for "the arms differ by less than the margin in all places" (two one-sided tests in each)."""
    known = [r for r in items if usable(r) and r.get("equivalence_p") is not None]
    right = [r for r in known if r["equivalence_p_adjusted"] < plan.alpha]
    beyond = [float(stats.t.sf((abs(r["estimate"]) - r["margin"]) / r["se"], r["df"])) for r in known]
    wrong = [
        r for r, p in zip(known, statistics.holm(beyond), strict=True)
        if p is not None and p < plan.alpha / 2
    ]  # fmt: skip
    alone = sum(r["equivalence_p"] < plan.alpha for r in known)
    counts = {
        "expected": expected,
        "right": len(right),
        "wrong": len(wrong),
        "open": len(known) - len(right) - len(wrong),
        "not_run": max(0, expected - sum(r["status"] != MISSING for r in items)),
    }
    margin = number(known[0]["margin"], known[0]["outcome"]) if known else ""
    return _conclude(
        items, known, wrong, alone, counts,
        said=f" (margin {margin})" if known else "",
        against="a larger difference",
    )  # fmt: skip


def _conclude(
    items: Sequence[Record],
    known: Sequence[Record],
    wrong: Sequence[Record],
    alone: int,
    counts: dict[str, int],
    said: str,
    against: str,
    undecided: str = "",
) -> tuple[str, str, dict[str, int]]:
    """The verdict on a claim about all places, why, and the counts.

    Args:
        items, known, wrong: effects in all places, those that say something, and those that contradict.
        alone: places in which the claim holds without adjustment, which is what a claim about all of them needs.
        said, against, undecided: words for the places as claimed, against the claim and between.
    """
    expected = counts["expected"]
    verdict = CONTRADICTED if wrong else HOLDS if known and alone >= expected else NOT_DECIDED
    parts = [f"as claimed in {alone if verdict == HOLDS else counts['right']} of {expected}{said}"]
    if wrong:
        found = listing([f"{place(r)} ({difference(r, r['outcome'])})" for r in wrong])
        parts.append(f"{against} in {len(wrong)}: {found}")
    if counts["open"] and verdict != HOLDS:
        parts.append(f"undecided in {counts['open']}{undecided}")
    parts += _no_evidence(items)
    if counts["not_run"]:
        parts.append(f"{counts['not_run']} not run")
    return verdict, "; ".join(parts), counts


def _no_evidence(items: Sequence[Record]) -> list[str]:
    parts = [
        f"no evidence from {found} ({words})"
        for status, words in (
            (ONE_SEED, "one training seed an arm"),
            (DEGENERATE, "nothing varies"),
            (SATURATED, "everybody crashes"),
        )
        if (found := sum(r["status"] == status for r in items))
    ]
    partial = sum(r["status"] == OK and not r.get("complete", True) for r in items)
    return [*parts, f"no evidence from {partial} (traffic levels are missing)"] if partial else parts


def _would_decide(items: Sequence[Record], counts: Mapping[str, int], equivalence: bool) -> str:
    """What would decide an open claim, in words."""
    words: list[str] = []
    if counts["not_run"]:
        words.append(f"the {count(counts['not_run'], 'setting')} that were not run")
    if few := sum(r["status"] == ONE_SEED for r in items):
        words.append(f"a second training seed in {few}")
    if equivalence:
        wide = [
            max(abs(r["low"]), abs(r["high"])) for r in items if usable(r) and r.get("margin") is not None
        ]
        if wide:
            margin, middle = (
                number(x, "crashed") for x in (items[0]["margin"], sorted(wide)[len(wide) // 2])
            )
            words.append(
                f"more seeds, until the intervals lie within the margin of {margin}; now they reach to {middle}"
            )
        return "; ".join(words) or "agents of both arms"
    open_ = [r for r in items if usable(r) and r["p_adjusted"] >= DEFAULT.alpha]
    planned = [r for r in open_ if "seeds_needed" in r]
    needed = sorted(r["seeds_needed"] for r in planned if r["seeds_needed"] is not None)
    if needed:
        margin = (
            number(planned[0]["margin"], planned[0]["outcome"]) if "margin" in planned[0] else "the margin"
        )
        words.append(
            f"{needed[-1]} seeds in each arm, to find an effect of {margin} in {len(needed)} of the open ones"
        )
    elif found := [r["detectable"] for r in open_ if r.get("detectable") is not None]:
        middle = sorted(found)[len(found) // 2]
        words.append(
            f"more seeds or scenarios: these find an effect of {number(middle, open_[0]['outcome'])} or more"
        )
    return "; ".join(words) or "an effect in the settings that show none yet"
