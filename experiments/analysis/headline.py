"""The answer to "does training among risky drivers make an agent safer?", in plain words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from experiments.analysis.effects import Record
from experiments.analysis.plan import DEFAULT, Plan
from experiments.analysis.pooling import ALL_TASKS
from experiments.analysis.statistics import DEGENERATE, MISSING, OK, ONE_SEED
from experiments.analysis.verdicts import CONTRADICTED, HOLDS, NOT_DECIDED
from experiments.analysis.wording import BACKENDS, count, difference, listing, number, p_value, place

VERBS = {
    HOLDS: ("holds", "hold"),
    CONTRADICTED: ("is contradicted", "are contradicted"),
    NOT_DECIDED: ("is not decided", "are not decided"),
}


def headlines(value: Mapping[str, Any], grid: Mapping[str, int], plan: Plan = DEFAULT) -> list[Record]:
    """The answer for each backend, by the plan's primary question over all agents.

    Args:
        value: ate, pooled, failures, claims, learnt and policies of an analysis.
        grid: number of traffic levels of each task in the complete grid.

    Returns:
        Records with backend, answer ("safer", "less safe", "not decided", "no answer"), text (sentences; where there is
        an answer, the first three say it) and cells.
    """
    parts = ("ate", "pooled", "failures", "claims", "learnt", "policies")
    return [
        _headline(backend, {k: [r for r in value[k] if r["backend"] == backend] for k in parts}, grid, plan)
        for backend in dict.fromkeys(record["backend"] for record in value["policies"])
    ]


def _headline(
    backend: str, own: Mapping[str, Sequence[Record]], grid: Mapping[str, int], plan: Plan
) -> Record:
    name, outcome = BACKENDS.get(backend, backend), plan.primary_outcome
    rows = [r for r in own["ate"] if r["outcome"] == outcome and r["status"] != MISSING]
    primary = next((r for r in own["pooled"] if r["primary"]), None)
    cells = primary["cells"] if primary else []
    if primary is None or primary["status"] != OK:
        text = [f"On {name} these results give no answer. {_why_not(own['ate'], outcome)}"]
        if primary is not None and primary["estimate"] is not None:
            text.append(
                f"For the record, in risky traffic the crash rate of the treated agents differs by "
                f"{difference(primary, outcome)} on average; this number says nothing."
            )
        return {"backend": backend, "answer": "no answer", "text": text, "cells": cells}
    decided = primary["p"] < plan.alpha
    answer = ("safer" if primary["estimate"] < 0 else "less safe") if decided else NOT_DECIDED
    text = [
        _primary(name, answer, [r for r in rows if r["term"] == "risky"], primary, own["learnt"], plan),
        _regular([r for r in rows if r["term"] == "regular"], own, outcome),
        _of_the_paper(own["claims"]),
    ]
    text.append(_graded(own["claims"]))
    text += _generality(primary, own["pooled"], outcome)
    text += _failing(own["failures"])
    used, every = primary["comparisons"]
    if every < sum(grid.values()) or used < every:
        text.append(f"This averages {used} of {sum(grid.values())} settings (task and traffic level).")
    return {"backend": backend, "answer": answer, "text": text + _careful(own["policies"]), "cells": cells}


def _primary(
    name: str, answer: str, rows: Sequence[Record], mean: Record, taught: Sequence[Record], plan: Plan
) -> str:
    """The first sentence: the answer, its size and its certainty."""
    beginning = (
        f"On {name}, it is not decided whether agents trained among risky drivers are safer in risky traffic"
        if answer == NOT_DECIDED
        else f"On {name}, agents trained among risky drivers are {answer} in risky traffic"
    )
    outcome = plan.primary_outcome
    treated, control = _rates(rows, outcome)
    unlearnt = [place(r) for r in taught if r["learnt"] is False]
    remark = f"; not learnt, but counted: {listing(unlearnt)}" if unlearnt else ""
    agents = count(mean["seeds"][0], "treated agent")
    p = p_value(mean["p"])
    p = p if p.startswith("<") else f"= {p}"
    p += f" adjusted for {len(plan.looks)} planned looks at the results" if plan.looks else ""
    return (
        f"{beginning}: they crash in {treated} of the test episodes and control agents in {control}, a difference of "
        f"{difference(mean, outcome)} (95 % interval; p {p}; {agents}, every task weighted "
        f"alike{remark})."
    )


def _regular(rows: Sequence[Record], own: Mapping[str, Sequence[Record]], outcome: str) -> str:
    """The second sentence: the price in regular traffic."""
    mean = next(
        r for r in own["pooled"] if (r["scope"], r["outcome"], r["term"]) == (ALL_TASKS, outcome, "regular")
    )
    treated, control = _rates(rows, outcome)
    harm = next(claim for claim in own["claims"] if claim["quantity"] == "equivalence")
    return (
        f"In regular traffic they crash in {treated} and control agents in {control}, a difference of "
        f"{difference(mean, outcome)}; that it is smaller than the margin on every task and level "
        f"{VERBS[harm['verdict']][0]}."
    )


def _of_the_paper(claims: Sequence[Record]) -> str:
    """The third sentence: what comes of the paper's claims."""
    groups: dict[str, list[str]] = {verdict: [] for verdict in VERBS}
    for claim in claims:
        if claim["source"] == "paper":
            groups[claim["verdict"]].append(f"that {claim['short']}")
    words = [f"{listing(shorts)} {VERBS[v][len(shorts) > 1]}" for v, shorts in groups.items() if shorts]
    return f"Of the paper's claims, {'; '.join(words)}."


def _rates(rows: Sequence[Record], outcome: str) -> tuple[str, str]:
    """Means of the treated and of the control agents, every task weighted alike."""
    tasks = [r["task"] for r in rows]
    weights = [1 / len(set(tasks)) / tasks.count(task) for task in tasks]
    treated, control = (
        number(sum(w * r[f"mean_{arm}"] for w, r in zip(weights, rows, strict=True)), outcome)
        for arm in ("treatment", "control")
    )
    return treated, control


def _graded(claims: Sequence[Record]) -> str:
    safety = next(claim for claim in claims if claim["outcome"] == "primary")
    counts = safety["counts"]
    settings = counts["expected"] - counts["not_run"]
    text = (
        f"One by one, {counts['right']} of {settings} settings are safer and {counts['wrong']} less safe, adjusted for "
        "their number"
    )
    if counts["at_least"] > counts["right"]:
        text += f"; taken together, at least {counts['at_least']} are safer"
    return text + "."


def _generality(primary: Record, pooled: Sequence[Record], outcome: str) -> list[str]:
    """How far the answer goes beyond these tasks."""
    population = primary["over_tasks"]
    if not population or not population["prediction"]:
        return []
    low, high = (number(value, outcome, signed=True) for value in population["prediction"])
    tasks = [
        r for r in pooled
        if r["scope"] != ALL_TASKS and (r["outcome"], r["term"]) == (outcome, primary["term"]) and r["status"] == OK
    ]  # fmt: skip
    ends = [extreme(tasks, key=lambda r: r["estimate"]) for extreme in (min, max)]
    least, most = (f"{number(r['estimate'], outcome, signed=True)} ({r['scope']})" for r in ends)
    return [
        f"By task the difference is between {least} and {most} points, with a standard deviation of "
        f"{number(population['tau'], outcome)}; for another task of their kind one has to expect a difference between "
        f"{low} and {high} points."
    ]


def _failing(failures: Sequence[Record]) -> list[str]:
    record = next((r for r in failures if r["scope"] == ALL_TASKS), None)
    if record is None or not any(failed for failed, _ in record["counts"]):
        return []
    (bad_t, of_t), (bad_c, of_c) = record["counts"]
    return [
        f"{bad_t} of {of_t} treated and {bad_c} of {of_c} control agents fail the gates: a difference of "
        f"{difference(record, 'crashed')}."
    ]


def _why_not(ate: Sequence[Record], outcome: str) -> str:
    """On what the comparisons rest that have no usable effect."""
    rows = [r for r in ate if (r["outcome"], r["term"]) == (outcome, "risky")]
    words = {
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
