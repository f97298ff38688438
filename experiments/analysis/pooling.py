"""Effects over several traffic levels: their mean, and their slope over traffic."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import pandas as pd

from experiments.analysis import statistics
from experiments.analysis.effects import UNINFORMATIVE, Record, adjust, as_record
from experiments.analysis.statistics import DEGENERATE, MISSING, OK
from experiments.analysis.tables import CONFIRMATORY, OUTCOMES, PLACE, TERMS, Pair, arm_values, pairs

ALL_TASKS = "all tasks"
# Comparisons whose agents pass the gates. An arm without spread is among them: agents that never crash are
# no failure, and leaving them out would favour the other arm.
INFORMATIVE = (OK, DEGENERATE)


def pooled(table: pd.DataFrame, records: Sequence[Record]) -> list[Record]:
    """Mean effect over the traffic levels of a task, and over all tasks where the outcome allows it.

    Each is given over all comparisons ("all") and over those whose agents pass the gates ("informative"). The
    choice of the latter looks at results, so they are exploratory where the two differ.

    Args:
        table: one row a cell, see `tables.units`.
        records: from `effects.effects` of the same table.

    Returns:
        Records as from `effects`, with scope (a task or "all tasks"), selection and comparisons [used,
        existing] instead of task and level.
    """
    agents = pairs(table)
    result = []
    for scope, group in _scopes(records):
        outcome, term = group[0]["outcome"], group[0]["term"]
        for selection in ("all", "informative"):
            used = [r for r in group if r["status"] != MISSING]
            if selection == "informative":
                used = [r for r in used if r["status"] in INFORMATIVE]
            places = [agents[tuple(record[column] for column in PLACE)] for record in used]
            estimate = statistics.pooled([arm_values(place, outcome, term) for place in places])
            result.append(
                {
                    "backend": group[0]["backend"],
                    "scope": scope,
                    "outcome": outcome,
                    "term": term,
                    "selection": selection,
                    **as_record(estimate),
                    "comparisons": [len(used), len(group)],
                    "cells": sorted({cell for record in used for cell in record["cells"]}),
                }
            )
    return result


def _scopes(records: Sequence[Record]) -> Iterator[tuple[str, list[Record]]]:
    """The groups of records that are averaged: (scope, records of one backend, outcome and term)."""
    for backend in dict.fromkeys(record["backend"] for record in records):
        for outcome in OUTCOMES:
            for term in TERMS:
                wanted = (backend, outcome, term)
                group = [r for r in records if (r["backend"], r["outcome"], r["term"]) == wanted]
                tasks = list(dict.fromkeys(record["task"] for record in group))
                for task in tasks:
                    yield task, [record for record in group if record["task"] == task]
                if OUTCOMES[outcome].poolable and len(tasks) > 1:
                    yield ALL_TASKS, group


def slopes(table: pd.DataFrame, records: Sequence[Record]) -> list[Record]:
    """Change per traffic level within each task, of the effect ("effect", the sum) and the outcome ("mean").

    "mean" averages over the two test traffics and the two arms.

    Returns:
        Records as from `effects` with quantity and levels (their numbers) instead of level and term, for the
        confirmatory outcomes. Status "uninformative" where the effect is so at any level. Holm over the
        tasks.
    """
    sums = {(r["backend"], r["task"], r["level"], r["outcome"]): r for r in records if r["term"] == "sum"}
    by_task: dict[tuple[str, str], dict[int, Pair]] = {}
    for (backend, task, level, _), pair in pairs(table).items():
        by_task.setdefault((backend, task), {})[level] = pair
    result: list[Record] = []
    for outcome in CONFIRMATORY:
        for (backend, task), by_level in by_task.items():
            levels = sorted(by_level)
            if len(levels) < 2:
                continue
            members = [sums[backend, task, level, outcome] for level in levels]
            strata = [arm_values(by_level[level], outcome, "sum") for level in levels]
            common: Record = {"backend": backend, "task": task, "outcome": outcome}
            common |= {"levels": [int(level) for level in levels]}
            cells = sorted({cell for member in members for cell in member["cells"]})
            # The sum counts two traffics, the mean is of one.
            for quantity, estimate in (
                ("effect", statistics.effect_slope(levels, strata)),
                ("mean", statistics.mean_slope(levels, [(t / 2, c / 2) for t, c in strata])),
            ):
                record = {**common, "quantity": quantity, **as_record(estimate), "cells": cells}
                _judge(record, members)
                result.append(record)
    for outcome in CONFIRMATORY:
        for backend in dict.fromkeys(record["backend"] for record in result):
            for quantity in ("effect", "mean"):
                wanted = (backend, outcome, quantity)
                adjust([r for r in result if (r["backend"], r["outcome"], r["quantity"]) == wanted], "Holm")
    return result


def _judge(record: Record, members: Sequence[Any]) -> None:
    bad = [member["level_name"] for member in members if member["status"] == UNINFORMATIVE]
    if bad and record["status"] != MISSING:
        record["status"] = UNINFORMATIVE
        record["reason"] = "; ".join(
            filter(None, [f"agents fail gates at {', '.join(bad)}", record["reason"]])
        )
