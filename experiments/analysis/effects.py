"""The average treatment effect of every setting (task and traffic level), over all of its trained agents.

The paper's ATE is a sum: (T - C) in risky traffic plus (T - C) in regular traffic. It is computed for each
trained agent first (risky + regular) and then compared between the arms, like its two terms and their
interaction. Agents that fail a gate count as the others do: an agent that did not learn is an outcome of its
training. How many fail is said beside every effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from experiments.analysis import statistics
from experiments.analysis.gates import FAILURES, GATES
from experiments.analysis.plan import DEFAULT, OUTCOMES, TERMS, Plan
from experiments.analysis.statistics import MISSING, OK, SATURATED, Estimate, Mean
from experiments.analysis.tables import CONFIRMATORY, PLACE, Pair, Place
from experiments.study.arms import TRAFFICS

Record = dict[str, Any]
ALL_CRASH = "every agent of both arms crashes in every episode"


def contrast(pair: Pair, outcome: str, term: str) -> Mean:
    """Treatment minus control in a setting."""
    arms = pair["treatment"], pair["control"]
    weighted = [(arm.scores(outcome, term), sign) for arm, sign in zip(arms, (1.0, -1.0), strict=True)]
    return statistics.linear(weighted, floor=sum(arm.floor(outcome, term) for arm in arms))


def below(pair: Pair, seed: int | None) -> Pair:
    """The agents of the first batches of seeds."""
    return {name: arm.below(seed) for name, arm in pair.items()}


def least(pair: Pair) -> int:
    """Seeds in the smaller arm."""
    return min(len(arm.seeds) for arm in pair.values())


def cells_of(pairs: Iterable[Pair]) -> list[str]:
    """The cells behind settings."""
    return sorted(cell for pair in pairs for arm in pair.values() for cell in arm.cells)


def estimated(of: Callable[[int | None], Mean], plan: Plan, seeds: int) -> tuple[Estimate, Mean, float]:
    """An estimate over all seeds whose p-value is right for all looks that were held.

    Args:
        of: the mean of the agents whose seed is below a number (None: of all). seeds: in the smallest arm.

    Returns:
        The estimate, the mean of the last look, and that look's share of the error rate.
    """
    looks = plan.looks_at(seeds)
    mean = of(looks[-1][0])
    found = statistics.interval(mean)
    if not plan.looks or found.status != OK:
        return found, mean, looks[-1][1]
    p_values = [statistics.interval(of(limit)).p for limit, _ in looks[:-1]] + [found.p]
    spent = [p / share for p, (_, share) in zip(p_values, looks, strict=True) if p is not None]
    return Estimate(**{**asdict(found), "p": min(1.0, *spent)}), mean, looks[-1][1]


def as_record(estimate: Estimate) -> Record:
    """An Estimate as the fields of a record; its group sizes are called seeds."""
    fields = asdict(estimate)
    fields["seeds"] = list(fields.pop("n"))
    return fields


def effects(
    pairs: Mapping[Place, Pair],
    verdicts: Sequence[Mapping[str, Any]] = (),
    plan: Plan = DEFAULT,
    outcomes: Sequence[str] | None = None,
    terms: Sequence[str] = tuple(TERMS),
) -> list[Record]:
    """Treatment effects of every setting, outcome and term.

    Args:
        pairs: from `tables.settings`. verdicts: records of `gates.gates`.

    Returns:
        Records with backend, task, level, level_name, outcome, term, estimate, se, low, high, p (right for all looks),
        df, seeds [treatment, control], status ("ok", "no interval: one seed", "degenerate", "missing"), reason, cells;
        mean_treatment, mean_control; failed [treatment, control] (agents that fail a gate); family (its name, None if
        exploratory), p_adjusted, adjustment, and in families low_adjusted, high_adjusted (exclude 0 where Holm rejects
        at this look) and detectable (true effect that is found with the plan's power at Holm's first step). With a
        margin: margin, equivalence_p, equivalence_p_adjusted, seeds_needed (in each arm, to find an effect as large as
        the margin). For confirmatory outcomes paired (the same by pairs of seeds), for their sums also percent (of the
        control's sum) and literal (the formula as the paper prints it).
    """
    records = []
    for place, pair in pairs.items():
        cells = cells_of([pair])
        standing = [verdict for verdict in verdicts if verdict["cell"] in set(cells)]
        for outcome in OUTCOMES if outcomes is None else outcomes:
            for term in terms:
                record = {**dict(zip(PLACE, place, strict=True)), "outcome": outcome, "term": term}
                record |= _effect(pair, outcome, term, plan) | _failures(standing)
                family = plan.family(str(place[1]), outcome, term)
                record["family"] = family.name if family else None
                records.append({**record, "cells": cells})
    _adjust(records, plan)
    for record in records:
        _plan_seeds(record, pairs[tuple(record[column] for column in PLACE)], plan)
    return records


def _effect(pair: Pair, outcome: str, term: str, plan: Plan) -> Record:
    found, mean, share = estimated(lambda seed: contrast(below(pair, seed), outcome, term), plan, least(pair))
    if plan.version > 1 and saturated(pair, outcome, term):
        found = Estimate(found.estimate, None, None, None, None, found.n, SATURATED, ALL_CRASH)
    record: Record = as_record(found) | {"share": share}
    scores = {name: arm.scores(outcome, term) for name, arm in pair.items()}
    for name, values in scores.items():
        record[f"mean_{name}"] = float(values.mean()) if len(values) else None
    if found.status in (MISSING, SATURATED):
        return record
    margin = OUTCOMES[outcome].margin
    if margin is not None and term in ("risky", "regular"):
        record |= {"margin": margin, "equivalence_p": statistics.equivalence(mean, margin)}
    if outcome in CONFIRMATORY:
        record["paired"] = as_record(statistics.interval(paired(pair, outcome, term)))
        if term == "sum":
            record["percent"] = as_record(statistics.ratio(scores["treatment"], scores["control"]))
            # As printed the formula ends "- sum R^C + sum R^C": the control's reward in risky traffic is subtracted
            # and that in regular traffic added.
            sides = pair["control"].scores(outcome, "interaction")
            record["literal"] = record["mean_treatment"] - float(sides.mean())
    return record


def saturated(pair: Pair, outcome: str, term: str) -> bool:
    """Whether every agent of both arms crashes in every episode that a term is about: none of them can be safer."""
    return outcome == "crashed" and all(
        arm.values[outcome][number].size > 0 and bool((arm.values[outcome][number] == 1).all())
        for arm in pair.values()
        for number, traffic in enumerate(TRAFFICS)
        if traffic in TERMS[term]
    )


def paired(pair: Pair, outcome: str, term: str) -> Mean:
    """Treatment minus control within each training seed of both arms."""
    t, c = pair["treatment"], pair["control"]
    both = set(t.seeds) & set(c.seeds)
    t, c = (arm.only([seed in both for seed in arm.seeds]) for arm in (t, c))
    if not both:
        return Mean(None, (), (0,), 0)
    return statistics.linear([(t.scores(outcome, term) - c.scores(outcome, term), 1.0)])


def _failures(standing: Sequence[Mapping[str, Any]]) -> Record:
    """How many agents of each arm fail the gates, and which, in words."""
    parts, failed = [], []
    for arm in ("treatment", "control"):
        verdicts = [verdict for verdict in standing if verdict["arm"] == arm]
        bad = [verdict for verdict in verdicts if verdict["passed"] is False]
        failed.append(len(bad))
        if bad:
            counts = {gate: sum(gate in verdict["failed"] for verdict in bad) for gate in GATES}
            which = ", ".join(f"{count} {FAILURES[gate]}" for gate, count in counts.items() if count)
            parts.append(f"{len(bad)} of {len(verdicts)} {arm} agents fail ({which})")
    text = " and ".join(parts)
    unchecked = [gate for gate in GATES if any(v["gates"][gate]["passed"] is None for v in standing)]
    if unchecked:
        open_ = "not checked: " + ", ".join(FAILURES[gate] for gate in unchecked)
        text = "; ".join(filter(None, (text, open_)))
    return {"failed": failed, "gates": text or None}


def _adjust(records: Sequence[Record], plan: Plan) -> None:
    """Adjusted p-values: Holm within each family and backend, Benjamini-Hochberg over everything else."""
    groups: dict[tuple[str, str | None], list[Record]] = {}
    for record in records:
        groups.setdefault((record["backend"], record["family"]), []).append(record)
    for (_, family), group in groups.items():
        adjust(group, "Holm" if family else "Benjamini-Hochberg", plan)
    for family_ in plan.families:
        if family_.equivalence:
            for backend in {record["backend"] for record in records}:
                group = [
                    r for r in records
                    if (r["backend"], r["outcome"], r["term"]) == (backend, family_.outcome, family_.term)
                ]  # fmt: skip
                adjusted = statistics.holm([record.get("equivalence_p") for record in group])
                for record, p in zip(group, adjusted, strict=True):
                    record["equivalence_p_adjusted"] = p


def adjust(family: Sequence[Record], method: str, plan: Plan = DEFAULT) -> None:
    """Add p_adjusted and adjustment to the records of one family, and with Holm the intervals that go with them."""
    correct = statistics.holm if method == "Holm" else statistics.benjamini_hochberg
    for record, p in zip(family, correct([record["p"] for record in family]), strict=True):
        record["p_adjusted"] = p
        record["low_adjusted"] = record["high_adjusted"] = record["adjustment"] = None
    tested = [record for record in family if record["p"] is not None]
    levels = (
        statistics.holm_levels([record["p"] for record in tested], plan.alpha) if method == "Holm" else []
    )
    for number, record in enumerate(tested):
        record["adjustment"] = f"{method} over {len(tested)}"
        if levels:
            level = levels[number] * record.get("share", 1.0)
            half = float(statistics.stats.t.ppf(1 - level / 2, record["df"])) * record["se"]
            record["low_adjusted"], record["high_adjusted"] = (
                record["estimate"] - half,
                record["estimate"] + half,
            )
            first = plan.alpha / len(tested) * record.get("share", 1.0)
            record["detectable"] = statistics.detectable(record["se"], record["df"], first, plan.power)
            record["first_level"] = first


def _plan_seeds(record: Record, pair: Pair, plan: Plan) -> None:
    """How many seeds would decide an effect of the size of the margin."""
    margin = OUTCOMES[record["outcome"]].margin
    if margin is None or "first_level" not in record:
        return
    mean = contrast(pair, record["outcome"], record["term"])
    record["seeds_needed"] = statistics.seeds_needed(mean, margin, record["first_level"], plan.power)
