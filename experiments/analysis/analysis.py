"""Everything that the report says, as frames: a pure function of the stored cells."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binomtest

from experiments.analysis import plan as plans
from experiments.analysis.cells import comparable, duplicates, is_main, unfinished, without
from experiments.analysis.claims import claims, price
from experiments.analysis.effects import (
    KEY,
    adjusted,
    contrasts,
    least_seeds,
    mean_over,
    means,
    slopes,
    variants,
)
from experiments.analysis.estimate import OK, Mean
from experiments.analysis.frontier import to_frontier
from experiments.analysis.gates import GATES, gates, learner_checks, learnt
from experiments.analysis.plan import DEFAULT, OUTCOMES, TERMS, Plan
from experiments.analysis.scores import (
    CRASH_KINDS,
    PLACE,
    Arms,
    Place,
    arms_of,
    in_order,
    with_outcomes,
)
from experiments.study.arms import ARMS, EXTRA_ARMS
from experiments.study.grid import BASELINES, LEARNER
from experiments.study.store import Results
from experiments.support.errors import UserError
from experiments.support.files import canonical_json, sha256_bytes

SCHEMA = 3
BOTH = [("treatment", "control")]
FURTHER = [(arm, against) for arm in EXTRA_ARMS for against in ("control", "treatment")]
ONE_TRAFFIC = ("risky", "regular")
CRASHES = [("crashed", term) for term in ONE_TRAFFIC]
SHOWN = ("crashed", "return", "mean_speed")  # outcomes of comparisons beside the plan's
DESCRIPTIVE = ("length", "distance", "arrived", "density", "stopped", "progress")
AGENT = [*PLACE, "arm", "seed"]
LEAST = 4  # control agents of a setting that can be dealt into two arms


@dataclass(frozen=True)
class Analysis:
    """What an analysis finds, as frames whose columns their functions document.

    effects, means: `effects.contrasts` and `effects.means`, of all comparisons (arm, against; tested_on; scenarios).
    slopes, gates, claims, placebo, policies, negative_control, provenance: see the functions of these names.
    plan, plan_hash: see `plan.as_data`. notes: missing, failed, damaged, incomplete, duplicates and left_out cells,
    with their reasons, and by plan 3 unfinished settings.
    price, learner, frontier: see `claims.price`, `gates.learner_checks` and `frontier.to_frontier`; None where the
    plan does not ask for them.
    """

    effects: pd.DataFrame
    means: pd.DataFrame
    slopes: pd.DataFrame
    claims: pd.DataFrame
    gates: pd.DataFrame
    policies: pd.DataFrame
    placebo: pd.DataFrame
    negative_control: float | None
    plan: dict[str, Any]
    plan_hash: str
    notes: dict[str, Any]
    provenance: dict[str, Any]
    price: pd.DataFrame | None = None
    learner: pd.DataFrame | None = None
    frontier: pd.DataFrame | None = None


def analyse(results: Results) -> Analysis:
    """Analyse the stored cells of a directory by the plan that its presets ask for.

    Raises:
        UserError: by a plan that counts complete settings alone, there is none yet.
    """
    chosen = comparable(results)
    main = [cell["key"] for cell in chosen.results.cells.values() if is_main(cell)]
    plan = plans.plan_of(str(key["profile"].get("preset")) for key in main)
    early = unfinished(results, chosen.results, plan.arms) if plan.version > 2 else {}
    known = without(chosen.results, settings=early)
    if early and not known.cells:
        lacking = "; ".join(f"{setting}: {reason}" for setting, reason in early.items())
        raise UserError(f"no setting is complete yet ({lacking}): run the sweep again to go on")
    episodes = with_outcomes(known)
    agents = own_agents(episodes)
    passed = gates(known.cells, known.gate_episodes)

    arms = arms_of(agents, [*OUTCOMES, *CRASH_KINDS])
    tested = [contrasts(arms, BOTH, [(o, t) for o in OUTCOMES for t in TERMS], plan)]
    tested += [contrasts(arms, [(arm, "control")], CRASHES, plan) for arm in plan.arms[2:]]
    there = [frame for frame in tested if len(frame)] or tested[:1]
    planned = adjusted(pd.concat(there, ignore_index=True), plan)
    both = planned[planned["arm"] == "treatment"]
    trends = slopes(arms, plan)
    beside = list(exploratory(episodes, arms, passed, replace(plan, looks=())))
    effects = pd.concat([planned, *(frame for frame, _ in beside)], ignore_index=True)
    effects = effects.drop_duplicates(
        KEY, ignore_index=True
    )  # what the plan tests of further arms stands first
    plan_data = plans.as_data(plan, GATES)
    return Analysis(
        effects=effects,
        means=pd.concat([means(both, plan), *(frame for _, frame in beside)], ignore_index=True),
        slopes=trends,
        claims=claims(both, trends, plan),
        gates=passed,
        policies=policies(episodes),
        placebo=placebo(agents, plan),
        negative_control=negative_control(episodes),
        plan=plan_data,
        plan_hash=sha256_bytes(canonical_json(plan_data).encode()),
        notes={
            "missing": [name for name in results.expected if name not in results.cells],
            "failed": dict(results.failed),
            "damaged": dict(results.damaged),
            "incomplete": chosen.incomplete,
            "duplicates": duplicates(known),
            "left_out": chosen.left_out,
            **({"unfinished": early} if plan.version > 2 else {}),
        },
        provenance=provenance(known),
        price=price(effects, plan) if plan.price else None,
        learner=learner_checks(known.cells, passed, agents, plan.learner, plan.arms)
        if plan.learner
        else None,
        frontier=to_frontier(episodes) if plan.version > 2 else None,
    )


def own_agents(episodes: pd.DataFrame) -> pd.DataFrame:
    """The test episodes of trained agents on the simulator of their training."""
    return episodes[episodes["kind"] == "agent"]


Frames = tuple[pd.DataFrame, pd.DataFrame]  # effects, and their means


def exploratory(
    episodes: pd.DataFrame, arms: Mapping[Place, Arms], passed: pd.DataFrame, plain: Plan
) -> Iterable[Frames]:
    """Comparisons beside the plan's; none of them decides a claim, and no p-value is adjusted.

    Kinds of crashes, further arms, the rule drivers as the mark to beat, the agents that pass the gates, and the same
    agents tested on another simulator.
    """
    agents = own_agents(episodes)
    questions = [(outcome, term) for outcome in SHOWN for term in ONE_TRAFFIC]
    kinds = contrasts(arms, BOTH, [(kind, term) for kind in CRASH_KINDS for term in ONE_TRAFFIC], plain)
    yield kinds, means(kinds, plain)
    further = contrasts(arms, FURTHER, questions, plain)
    scopes = means(further[further["outcome"] == "crashed"], plain, variants())
    yield further, pd.concat([means(further, plain), scopes])
    rules = episodes[episodes["kind"] == "baseline"]
    rules = rules.assign(arm=rules["policy"], seed=0)
    drivers = arms_of(pd.concat([agents, rules]), SHOWN)
    mark = contrasts(drivers, [(arm, "careful") for arm in ARMS], questions, plain)
    yield mark, means(mark, plain)

    both = contrasts(arms, BOTH, CRASHES, plain)
    bad = passed.loc[passed["passed"].astype(object) == False, "cell"]  # noqa: E712
    sound = contrasts(arms_of(agents[~agents["cell"].isin(bad)], ["crashed"]), BOTH, CRASHES, plain)
    passing = means(sound[least_seeds(sound) > 1], plain, lambda rows: {"agents that pass the gates": rows})
    other_ways = variants(learnt(passed, plain.learnt))
    yield both.iloc[:0], pd.concat([means(both, plain, other_ways), passing])

    tests = episodes[(episodes["kind"] == "test") & (episodes["tested_on"] != episodes["backend"])]
    for other in sorted({*tests["tested_on"]}):
        away = tests[tests["tested_on"] == other].merge(agents[AGENT].drop_duplicates())
        home = agents.merge(away[[*AGENT, "traffic", "scenario"]])  # the same agents on the same scenarios
        for rows, labels in ((away, {"tested_on": other, "scenarios": other}), (home, {"scenarios": other})):
            effects = contrasts(arms_of(rows, ["crashed"]), BOTH, CRASHES, plain, **labels)
            yield effects, means(effects, plain)


def placebo(episodes: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The same analysis between two halves of the control agents; about 5 % of the effects should be "significant".

    Returns:
        A row a backend and outcome: comparisons, rejected (with p below alpha), p (of so many rejections or more if 5 %
        are expected) and the mean over settings of the plan's primary term: estimate, low, high.
    """
    control = episodes[episodes["arm"] == "control"]
    number = control.groupby(PLACE)["seed"].transform(lambda seeds: seeds.rank(method="dense") - 1)
    halves = control.assign(arm=(number % 2).map({0.0: "control", 1.0: "treatment"}))
    enough = number.groupby([control[column] for column in PLACE]).transform("max") >= LEAST - 1
    single = replace(plan, looks=())  # half the seeds: the planned looks do not apply
    questions = [(outcome, term) for outcome in ("return", "crashed") for term in ("sum", plan.primary_term)]
    effects = contrasts(arms_of(halves[enough], ["return", "crashed"]), BOTH, questions, single)
    rows = []
    for (backend, outcome), own in effects.groupby(["backend", "outcome"], sort=False):
        known = own[(own["term"] == "sum") & (own["status"] == OK)]
        if known.empty:
            continue
        rejected = int((known["p"] < plan.alpha).sum())
        p = binomtest(rejected, len(known), plan.alpha, alternative="greater").pvalue
        found = mean_over(own[own["term"] == plan.primary_term], single)
        rows.append(
            {"backend": backend, "outcome": outcome, "comparisons": len(known), "rejected": rejected, "p": p}
            | {name: found[name] for name in ("estimate", "low", "high")}
        )
    columns = ["backend", "outcome", "comparisons", "rejected", "p", "estimate", "low", "high"]
    return pd.DataFrame(rows, columns=columns)


def negative_control(episodes: pd.DataFrame, policy: str = "careful") -> float | None:
    """The largest effect of a rule driver taken as both arms, which has to be 0; None if the rule was not run."""
    rule = episodes[(episodes["policy"] == policy) & (episodes["kind"] == "baseline")]
    if rule.empty:
        return None
    twice = pd.concat([rule.assign(seed=0, arm=arm) for arm in ARMS], ignore_index=True)
    questions = [(outcome, term) for outcome in OUTCOMES for term in TERMS]
    return float(contrasts(arms_of(twice, list(OUTCOMES)), BOTH, questions)["estimate"].abs().max())


def policies(episodes: pd.DataFrame) -> pd.DataFrame:
    """How every policy does, in every setting and traffic: trained agents by arm, and the others.

    Returns:
        A row a PLACE, policy, arm (empty for policies that are not trained) and traffic, in the grid's order: n and
        unit ("training seed" or "test episode"), the mean of every outcome and of length [steps], distance [m], arrived
        (share), density (other vehicles within 200 m), stopped (share of the steps) and progress (m per second that the
        episode was to last); "<outcome> se" over those units, NaN with one of them.
    """
    rows = episodes[episodes["tested_on"] == episodes["backend"]]
    arms = rows["arm"].where(rows["kind"] != "baseline", "").fillna("").astype(str)
    rows = rows.assign(
        arm=arms,
        unit=rows["seed"].where(arms != "", rows["scenario"]),
        progress=rows["distance"] / rows["seconds"],
    )
    columns = [*OUTCOMES, *DESCRIPTIVE]
    group = [*PLACE, "policy", "arm", "traffic"]
    rows = rows.astype(dict.fromkeys(columns, float))
    grouped = rows.groupby([*group, "unit"], sort=False)[columns].mean().groupby(group, sort=False)
    errors = grouped[list(OUTCOMES)].sem().add_suffix(" se")
    frame = grouped.mean().join(errors).reset_index()
    frame.insert(len(group), "n", grouped.size().to_numpy())
    frame.insert(len(group) + 1, "unit", np.where(frame["arm"] != "", "training seed", "test episode"))
    own = sorted({*frame["policy"]} - {LEARNER, *BASELINES})
    ranks = {name: rank for rank, name in enumerate((*ARMS, *EXTRA_ARMS, *BASELINES, *own))}
    frame["rank"] = frame["arm"].where(frame["arm"] != "", frame["policy"]).map(ranks)
    return (
        in_order(frame, "backend", "task", "level", "rank", "traffic")
        .drop(columns="rank")
        .reset_index(drop=True)
    )


def provenance(results: Results) -> dict[str, Any]:
    """Where the numbers come from.

    Returns:
        presets, versions (each with all values found), seconds (computing time of training and tests),
        finished (times of the first and last cell), cells (for each its files' checksums), hash (of all that:
        equal hashes mean equal results).
    """
    versions: dict[str, set[str]] = {}
    presets, finished, seconds = set(), [], 0.0
    for cell in results.cells.values():
        packages = (cell.get("provenance") or {}).get("packages", {})
        for name, version in {**packages, **cell["versions"]}.items():
            if version is not None:  # without a build tag, as in the cells' names
                versions.setdefault(name, set()).add(str(version).partition("+")[0])
        presets.add(str(cell["key"]["profile"].get("preset")))
        timing = cell.get("timing", {})
        seconds += timing.get("train_seconds", 0.0) + timing.get("test_seconds", 0.0)
        finished += [timing["finished"]] if "finished" in timing else []
    files = {name: cell["files"] for name, cell in sorted(results.cells.items())}
    return {
        "presets": sorted(presets),
        "versions": {name: sorted(found) for name, found in sorted(versions.items())},
        "seconds": seconds,
        "finished": [min(finished), max(finished)] if finished else None,
        "cells": files,
        "hash": sha256_bytes(canonical_json(files).encode()),
    }


def as_json(analysis: Analysis) -> dict[str, Any]:
    """An analysis as strict JSON; a frame is {"columns": [...], "rows": [[...], ...]}.

    Numbers have twelve significant digits, since those beyond differ between processors; NaN is null.
    """
    value: dict[str, Any] = {"schema": SCHEMA}
    for field in fields(analysis):
        part = getattr(analysis, field.name)
        if part is None and field.name in ("price", "learner", "frontier"):
            continue
        if isinstance(part, pd.DataFrame):
            table = part.drop(columns="looks", errors="ignore")
            part = {"columns": list(table.columns), "rows": table.to_numpy(dtype=object).tolist()}
        value[field.name] = _strict(part)
    return value


def _strict(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.12g}") if math.isfinite(value) else None
    return None if value is pd.NA else value


def stored(path: Path) -> Analysis | None:
    """The analysis in an analysis.json; None if the file is of another version. Raises ValueError if it is damaged."""
    value = json.loads(path.read_text())
    if value.pop("schema", None) != SCHEMA:
        return None
    frames = {
        name: pd.DataFrame(part["rows"], columns=part["columns"])
        if isinstance(part, dict) and part.keys() == {"columns", "rows"}
        else part
        for name, part in value.items()
    }
    effects = frames["effects"]
    variances = (effects["se"] ** 2).fillna(0.0), effects["df"].fillna(1.0)
    looks = zip(effects["estimate"], *variances, least_seeds(effects), strict=True)
    effects["looks"] = [(Mean(*look),) for look in looks]
    return Analysis(**frames)
