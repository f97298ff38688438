"""The average treatment effect of every task and traffic level, and its placebo.

The paper's ATE is a sum: (T - C) in risky traffic plus (T - C) in regular traffic. It is computed for each
trained agent first (risky mean + regular mean) and then compared between the arms, like its two terms and
their interaction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import pandas as pd
from scipy.stats import binomtest

from experiments.analysis import statistics
from experiments.analysis.gates import FAILURES, GATES
from experiments.analysis.statistics import ALPHA, MISSING, OK, Estimate
from experiments.analysis.tables import CONFIRMATORY, OUTCOMES, PLACE, TERMS, Pair, arm_values, pairs

UNINFORMATIVE = "uninformative"
Record = dict[str, Any]


def effects(
    table: pd.DataFrame,
    verdicts: Sequence[Mapping[str, Any]] = (),
    outcomes: Sequence[str] = tuple(OUTCOMES),
    terms: Sequence[str] = tuple(TERMS),
) -> list[Record]:
    """Treatment effects of every task, traffic level, outcome and term.

    Args:
        table: one row a cell, see `tables.units`.
        verdicts: records of `gates.gates`; an effect that rests on an agent that failed is "uninformative".
        outcomes: names from OUTCOMES. terms: names from TERMS.

    Returns:
        Records with backend, task, level, level_name, outcome, term, estimate, low, high, p, df, seeds
        [treatment, control], status ("ok", "no interval: one seed", "degenerate", "uninformative",
        "missing"), reason, cells; mean_treatment, mean_control; p_adjusted and adjustment ("Holm over n",
        "Benjamini-Hochberg over n"). For confirmatory outcomes also paired (the same by pairs of seeds), margin
        and equivalence_p; for their sums detectable (true effect found with 80 % power), percent (relative to
        the control's sum) and literal (the formula as the paper prints it).
    """
    verdict_of = {verdict["cell"]: verdict for verdict in verdicts}
    records = []
    for place, pair in pairs(table).items():
        cells = sorted(cell for arm in pair.values() for cell in arm["cell"])
        standing = [verdict_of[cell] for cell in cells if cell in verdict_of]
        for outcome in outcomes:
            for term in terms:
                record = {**dict(zip(PLACE, place, strict=True)), "outcome": outcome, "term": term}
                record |= _effect(pair, outcome, term)
                _judge(record, standing)
                records.append({**record, "cells": cells})
    _adjust(records)
    return records


def as_record(estimate: Estimate) -> Record:
    """An Estimate as the fields of a record; its group sizes are called seeds."""
    fields = asdict(estimate)
    fields["seeds"] = list(fields.pop("n"))
    return fields


def _effect(pair: Pair, outcome: str, term: str) -> Record:
    treatment, control = arm_values(pair, outcome, term)
    record = as_record(statistics.welch(treatment, control))
    record["mean_treatment"] = float(treatment.mean()) if len(treatment) else None
    record["mean_control"] = float(control.mean()) if len(control) else None
    if outcome not in CONFIRMATORY or record["status"] == MISSING:
        return record
    record["paired"] = as_record(statistics.paired(dict(treatment), dict(control)))
    margin = OUTCOMES[outcome].margin
    if margin is not None and term in ("risky", "regular"):
        record |= {"margin": margin, "equivalence_p": statistics.equivalence(treatment, control, margin)}
    if term == "sum":
        record["detectable"] = statistics.detectable(treatment, control)
        record["percent"] = as_record(statistics.ratio(treatment, control))
        # As printed the formula ends "- sum R^C + sum R^C": the control's second sum is added, not
        # subtracted.
        sides = arm_values(pair, outcome, "interaction")[1]
        record["literal"] = record["mean_treatment"] + float(sides.mean())
    return record


def _judge(record: Record, standing: Sequence[Mapping[str, Any]]) -> None:
    """Status and reason of a record, given the verdicts on the agents it rests on."""
    reasons = [record["reason"]] if record["reason"] else []
    if record["status"] != MISSING and any(verdict["passed"] is False for verdict in standing):
        record["status"] = UNINFORMATIVE
        reasons.insert(0, failures(standing))
    unchecked = [gate for gate in GATES if any(v["gates"][gate]["passed"] is None for v in standing)]
    if unchecked:
        reasons.append("not checked: " + ", ".join(FAILURES[gate] for gate in unchecked))
    record["reason"] = "; ".join(reasons) or None


def failures(standing: Sequence[Mapping[str, Any]]) -> str:
    """Which agents fail which gates, in words: "2 of 3 control agents fail (2 constant policy)"."""
    parts = []
    for arm in ("treatment", "control"):
        verdicts = [verdict for verdict in standing if verdict["arm"] == arm]
        failed = [verdict for verdict in verdicts if verdict["passed"] is False]
        if failed:
            counts = {gate: sum(gate in verdict["failed"] for verdict in failed) for gate in GATES}
            which = ", ".join(f"{count} {FAILURES[gate]}" for gate, count in counts.items() if count)
            parts.append(f"{len(failed)} of {len(verdicts)} {arm} agents fail ({which})")
    return " and ".join(parts)


def _adjust(records: list[Record]) -> None:
    """Adjusted p-values: Holm within each confirmatory family, Benjamini-Hochberg over everything else.

    A family is one backend, one confirmatory outcome, the sum, all tasks and levels.
    """
    families: dict[tuple[str, str], list[Record]] = {}
    for record in records:
        confirmatory = record["outcome"] in CONFIRMATORY and record["term"] == "sum"
        families.setdefault((record["backend"], record["outcome"] if confirmatory else ""), []).append(record)
    for (_, outcome), family in families.items():
        adjust(family, "Holm" if outcome else "Benjamini-Hochberg")


def adjust(family: Sequence[Record], method: str) -> None:
    """Add p_adjusted and adjustment to the records of one family."""
    correct = statistics.holm if method == "Holm" else statistics.benjamini_hochberg
    p_values = [record["p"] for record in family]
    tested = sum(p is not None for p in p_values)
    for record, p in zip(family, correct(p_values), strict=True):
        record["p_adjusted"] = p
        record["adjustment"] = f"{method} over {tested}" if p is not None else None


def placebo(table: pd.DataFrame) -> list[Record]:
    """Control against control: the same analysis where there is no effect by construction.

    The control agents of every task and level are dealt alternately, in order of their seeds, into two false
    arms; this needs four of them. About 5 % of the comparisons should come out "significant"; the sum only,
    because the terms of one comparison are not independent.

    Returns:
        A record a backend and confirmatory outcome: comparisons, rejected, p (of so many rejections or more
        if 5 % are expected), cells.
    """
    rows = table[(table["kind"] == "agent") & (table["arm"] == "control")].sort_values("seed", kind="stable")
    rows = rows.assign(number=rows.groupby(PLACE).cumcount())
    rows = rows[rows.groupby(PLACE)["number"].transform("max") >= 3]
    if rows.empty:
        return []
    false_arms = rows.assign(arm=rows["number"].map(lambda number: ("control", "treatment")[number % 2]))
    records = effects(false_arms, outcomes=CONFIRMATORY, terms=("sum",))
    result = []
    for backend in dict.fromkeys(record["backend"] for record in records):
        for outcome in CONFIRMATORY:
            tested = [
                r for r in records if (r["backend"], r["outcome"], r["status"]) == (backend, outcome, OK)
            ]  # fmt: skip
            if tested:
                rejected = sum(record["p"] < ALPHA for record in tested)
                p = float(binomtest(rejected, len(tested), ALPHA, alternative="greater").pvalue)
                cells = sorted({cell for record in tested for cell in record["cells"]})
                result.append(
                    {"backend": backend, "outcome": outcome, "comparisons": len(tested), "rejected": rejected}
                    | {"p": p, "cells": cells}
                )
    return result
