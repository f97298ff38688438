"""What the effects say about each claim, and the answer in plain words; decided by intervals, not by eye."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from experiments.analysis.effects import UNINFORMATIVE, Record
from experiments.analysis.pooling import ALL_TASKS, INFORMATIVE
from experiments.analysis.statistics import ALPHA, DEGENERATE, MISSING, OK, ONE_SEED
from experiments.analysis.wording import BACKENDS, count, difference, listing, number, place

HOLDS, CONTRADICTED, NOT_DECIDED = "holds", "contradicted", "not decided"


@dataclass(frozen=True)
class Claim:
    """A statement about every task (and level).

    source: "paper" for the paper's own, "crash rate" for the same said of crashes, which is what safety means
    here.
    quantity: "ate" (each cell's sum), "effect" (its slope over traffic) or "mean" (the outcome's slope).
    sign: what the quantity has to be everywhere.
    """

    text: str
    source: str
    quantity: str
    outcome: str
    sign: int


CLAIMS = (
    Claim(
        "Training among risky drivers raises the return, on every task and traffic level",
        "paper",
        "ate",
        "return",
        +1,
    ),
    Claim("This effect on the return grows with traffic, on every task", "paper", "effect", "return", +1),
    Claim("The return falls as traffic grows, on every task", "paper", "mean", "return", -1),
    Claim(
        "Training among risky drivers lowers the crash rate, on every task and traffic level",
        "crash rate",
        "ate",
        "crashed",
        -1,
    ),
    Claim("This effect on crashes grows with traffic, on every task", "crash rate", "effect", "crashed", -1),
    Claim("The crash rate rises as traffic grows, on every task", "crash rate", "mean", "crashed", +1),
)


def claims(ate: Sequence[Record], slopes: Sequence[Record], grid: Mapping[str, int]) -> list[Record]:
    """The verdict on every claim, for each backend.

    Args:
        ate: from `effects.effects`. slopes: from `pooling.slopes`.
        grid: number of traffic levels of each task in the complete grid; a claim about every task and level
        holds
            only if none of them is missing.

    Returns:
        Records with claim, source, backend, outcome, verdict ("holds", "contradicted", "not decided"),
        reason, cells.
    """
    result = []
    for backend in dict.fromkeys(record["backend"] for record in ate):
        for claim in CLAIMS:
            pool = ate if claim.quantity == "ate" else slopes
            wanted = ("sum" if claim.quantity == "ate" else claim.quantity, backend, claim.outcome)
            items = [
                r for r in pool if (r.get("term", r.get("quantity")), r["backend"], r["outcome"]) == wanted
            ]
            expected = sum(grid.values()) if claim.quantity == "ate" else len(grid)
            verdict, reason = decide(items, claim.sign, expected, claim.outcome)
            result.append(
                {
                    "claim": claim.text,
                    "source": claim.source,
                    "backend": backend,
                    "outcome": claim.outcome,
                    "verdict": verdict,
                    "reason": reason,
                    "cells": sorted({cell for item in items for cell in item["cells"]}),
                }
            )
    return result


def decide(items: Sequence[Record], sign: int, expected: int, outcome: str) -> tuple[str, str]:
    """Verdict and reason for "the quantity has this sign in all `expected` places".

    Only records with status "ok" count, after adjustment for their number: one on the wrong side contradicts,
    all of them on the right side confirm, everything else leaves it open.
    """
    sides = [
        0 if r["status"] != OK or r["p_adjusted"] >= ALPHA else 1 if r["estimate"] * sign > 0 else -1
        for r in items
    ]
    support = [r for r, side in zip(items, sides, strict=True) if side > 0]
    against = [r for r, side in zip(items, sides, strict=True) if side < 0]
    parts = [f"as claimed in {len(support)} of {expected}"]
    if against:
        found = listing([f"{place(r)} ({difference(r, outcome)})" for r in against])
        parts.append(f"the opposite in {len(against)}: {found}")
    open_ = sum(r["status"] == OK and side == 0 for r, side in zip(items, sides, strict=True))
    if open_:
        parts.append(f"undecided in {open_} (interval includes 0 after Holm)")
    for status, words in (
        (UNINFORMATIVE, "agents fail the gates"),
        (ONE_SEED, "one training seed an arm"),
        (DEGENERATE, "no spread between seeds"),
    ):
        if found := sum(r["status"] == status for r in items):
            parts.append(f"no evidence from {found} ({words})")
    absent = expected - sum(r["status"] != MISSING for r in items)
    if absent > 0:
        parts.append(f"{absent} not run")
    verdict = CONTRADICTED if against else HOLDS if len(support) >= expected else NOT_DECIDED
    return verdict, "; ".join(parts)


def headlines(ate: Sequence[Record], pooled: Sequence[Record], policies: Sequence[Record]) -> list[Record]:
    """The answer to "does training among risky drivers make an agent safer?", for each backend.

    Returns:
        Records with backend, answer ("safer", "less safe", "not decided", "no answer"), text (sentences) and
        cells.
    """
    return [
        _headline(
            backend,
            [r for r in ate if (r["backend"], r["outcome"]) == (backend, "crashed")],
            [r for r in pooled if (r["backend"], r["outcome"]) == (backend, "crashed")],
            [r for r in policies if r["backend"] == backend],
        )
        for backend in dict.fromkeys(record["backend"] for record in policies)
    ]


def _headline(
    backend: str, ate: Sequence[Record], pooled: Sequence[Record], policies: Sequence[Record]
) -> Record:
    name = BACKENDS.get(backend, backend)
    risky = _overall(pooled, "risky", "informative")
    if risky is None or risky["status"] != OK:
        text = [f"On {name} these results give no answer. {_why_not(ate)}"]
        everything = _overall(pooled, "risky", "all")
        if everything is not None and everything["estimate"] is not None:
            text.append(
                f"For the record, in risky traffic the crash rate of the treated agents differs by "
                f"{difference(everything, 'crashed')} on average; this number says nothing."
            )
        return {"backend": backend, "answer": "no answer", "text": text, "cells": _cells(everything)}
    used = [r for r in ate if r["status"] in INFORMATIVE]
    if risky["low"] > 0 or risky["high"] < 0:
        answer = "safer" if risky["high"] < 0 else "less safe"
        text = [f"On {name}, agents trained among risky drivers are {answer} in risky traffic."]
    else:
        answer = NOT_DECIDED
        agents = count(risky["seeds"][0], "treated agent")
        text = [f"On {name}, {agents} are too few to tell: the interval includes 0."]
    text += [_sentence(used, term, _overall(pooled, term, "informative")) for term in ("risky", "regular")]
    n, of = risky["comparisons"]
    text.append(f"This averages {n} of {count(of, 'comparison')}.")
    if n < of:
        text.append(
            f"The others say nothing. {_why_not(ate)} They were set aside after the fact, so read the mean as "
            "exploratory."
        )
    text += _careful(policies)
    return {"backend": backend, "answer": answer, "text": text, "cells": _cells(risky)}


def _overall(pooled: Sequence[Record], term: str, selection: str) -> Record | None:
    """The mean over all tasks, or over the only one."""
    found = [r for r in pooled if (r["term"], r["selection"]) == (term, selection)]
    return next((r for r in found if r["scope"] == ALL_TASKS), found[0] if len(found) == 1 else None)


def _cells(record: Record | None) -> list[str]:
    return record["cells"] if record else []


def _sentence(used: Sequence[Record], term: str, mean: Record | None) -> str:
    rows = [r for r in used if r["term"] == term]
    if mean is None or not rows:
        return f"In {term} traffic nothing can be compared."
    treated, control = (
        number(sum(r[f"mean_{arm}"] for r in rows) / len(rows), "crashed") for arm in ("treatment", "control")
    )
    return (
        f"In {term} traffic treated agents crash in {treated} of the test episodes and control agents in {control}: "
        f"a difference of {difference(mean, 'crashed')}."
    )


def _why_not(ate: Sequence[Record]) -> str:
    """On what the comparisons rest that have no usable effect."""
    rows = [r for r in ate if r["term"] == "risky"]
    words = {
        UNINFORMATIVE: "on agents that fail the gates (see below)",
        ONE_SEED: "on a single training seed in an arm",
        DEGENERATE: "on seeds that do not differ at all",
        MISSING: "on one arm alone",
    }
    counts = {status: sum(r["status"] == status for r in rows) for status in words}
    found = [f"{n} {'rests' if n == 1 else 'rest'} {words[status]}" for status, n in counts.items() if n]
    if not found:
        return "No agents were trained."
    return f"Of {count(len(rows), 'comparison')} (task and traffic level), {listing(found)}."


def _careful(policies: Sequence[Record]) -> list[str]:
    """How the careful driver does where agents were trained: the mark to beat."""
    means = {}
    for policy in ("careful", "dqn"):
        rows = [r for r in policies if r["policy"] == policy and r["traffic"] == "risky"]
        means[policy] = {(r["task"], r["level"], r["arm"]): r["mean"]["crashed"] for r in rows}
    places = {key[:2] for key in means["dqn"]} & {key[:2] for key in means["careful"]}
    if not places:
        return []
    careful, trained = (
        number(sum(values) / len(values), "crashed")
        for policy in ("careful", "dqn")
        for values in [[value for key, value in means[policy].items() if key[:2] in places]]
    )
    return [
        f"The mark to beat: a careful driver of fixed rules crashes in {careful} of the same risky episodes, "
        f"the trained agents of both arms in {trained}."
    ]
