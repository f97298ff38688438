"""Everything that the report says, as frames: a pure function of the stored cells."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binom

from agents.rules import POLICIES
from experiments.analysis import plan as plans
from experiments.analysis.by_task import COLUMNS, OWN, SURROGATES, by_task
from experiments.analysis.claims import claims, primary
from experiments.analysis.comparable import comparable, incomplete, leave_out, main_cells, unfinished
from experiments.analysis.competence import competence, competent
from experiments.analysis.drivers import drivers, to_frontier
from experiments.analysis.effects import WORKING_COLUMNS, adjusted, contrasts, means, slopes
from experiments.analysis.estimate import OK, combine, equal_task_weights
from experiments.analysis.gates import THRESHOLDS, gates, learner_checks
from experiments.analysis.plan import ALPHA, DEFAULT, OUTCOMES, TERMS, Outcome, Plan
from experiments.analysis.scores import arms_of, at_home, in_order, undrivable, with_outcomes
from experiments.study.design.arms import ARMS, EXTRA_ARMS
from experiments.study.design.cell import LEARNER
from experiments.study.results.loaded import SETTING, Results
from experiments.support.errors import UserError
from experiments.support.files import digest_of, plain_json

SCHEMA = 5
BOTH = ("treatment", "control")
ONE_TRAFFIC = ("risky", "regular")
# Comparisons in addition to the plan's: further arms, and the rule driver that is the mark to beat, as (arm, against).
FURTHER = [*product(EXTRA_ARMS, ARMS), *((arm, "careful") for arm in ARMS)]
SHOWN = [(outcome, term) for outcome in ("crashed", "return", "mean_speed") for term in ONE_TRAFFIC]
DESCRIPTIVE = ("length", "distance", "arrived", "density", "stopped", "progress", "crash_closing_speed")
LEAST = 4  # control agents of a setting that can be dealt into two arms


@dataclass(frozen=True)
class Analysis:
    """What an analysis finds, as frames whose columns the functions of these names document.

    effects, means: of all comparisons (arm, against) on the simulator of the training. plan, plan_hash: see
    `plan.as_data`. notes: missing, failed, damaged and left_out cells, unfinished and incomplete settings, with their
    reasons; stage, the last one of the plan that is complete; and `scores.undrivable`. primary: see `claims.primary`.
    learner (see `gates.learner_checks`): empty where the plan does not ask for it. frontier: see
    `drivers.to_frontier`. by_task: see `by_task.by_task`. drivers: see `drivers.drivers`. competence: see
    `competence.competence`. competent: as by_task, of the settings whose control agents are competent.
    """

    effects: pd.DataFrame
    means: pd.DataFrame
    slopes: pd.DataFrame
    claims: pd.DataFrame
    gates: pd.DataFrame
    policies: pd.DataFrame
    placebo: pd.DataFrame
    plan: dict[str, Any]
    plan_hash: str
    notes: dict[str, Any]
    provenance: dict[str, Any]
    primary: pd.DataFrame
    learner: pd.DataFrame
    frontier: pd.DataFrame
    by_task: pd.DataFrame
    drivers: pd.DataFrame
    competence: pd.DataFrame
    competent: pd.DataFrame


def analyse(results: Results, own: Mapping[str, Outcome] | None = None) -> Analysis:
    """Analyse the stored cells of a directory by the plan that its presets ask for.

    Args:
        own: further outcomes, of the user's own; they are exploratory.

    Raises:
        UserError: no cell can be compared; or by a plan that counts complete settings alone, there is none yet.
    """
    chosen, left_out = comparable(results)
    if not chosen.cells:
        raise UserError(f"nothing to report in {results.directory}: {next(iter(left_out.values()))}")
    plan = plans.plan_of(main_cells(chosen.table)["preset"])
    early = unfinished(results, chosen) if plan.version > 2 else {}
    known = leave_out(chosen, settings=early)
    if early and not known.cells:
        lacking = "; ".join(f"{setting}: {reason}" for setting, reason in early.items())
        raise UserError(f"no setting is complete yet ({lacking}): run the sweep again to go on")
    outcomes = {**OUTCOMES, **(own or {})}
    episodes = with_outcomes(known, {**OWN, **SURROGATES, **outcomes})
    agents = episodes[episodes["kind"] == "agent"]
    passed = gates(known.cells, known.gate_episodes)
    verdicts = competence(known.cells, known.gate_episodes)
    stage, counted = plans.reached(plan, known.table[known.table["kind"] == "agent"])

    arms = arms_of(agents, outcomes)
    asked = contrasts(arms, {BOTH: [*product(outcomes, TERMS)]})
    both = adjusted(asked, counted)
    trends = slopes(arms, plan)
    careful = episodes[(episodes["policy"] == "careful") & (episodes["kind"] == "baseline")]
    everybody = arms_of(pd.concat([agents, careful.assign(seed=0, arm="careful")]))
    beside = contrasts(everybody, dict.fromkeys(FURTHER, SHOWN))
    crashes = both[(both["outcome"] == "crashed") & both["term"].isin(ONE_TRAFFIC)]
    mean = [
        means(asked, counted, outcomes=outcomes),
        means(crashes, counted, leave_one_out=True),
        means(beside, counted),
    ]
    effects = pd.concat([both, beside], ignore_index=True)
    plan_data = plans.as_data(plan, THRESHOLDS)
    return Analysis(
        effects=effects,
        means=pd.concat(mean, ignore_index=True),
        slopes=trends,
        claims=claims(both[counted.covers(both)], trends, plan),
        gates=passed,
        policies=policies(episodes, outcomes),
        placebo=placebo(agents, plan),
        plan=plan_data,
        plan_hash=digest_of(plan_data),
        notes={
            "missing": [n for n in results.expected if n not in {**results.cells, **results.failed}],
            "failed": dict(results.failed),
            "damaged": dict(results.damaged),
            "left_out": left_out,
            "unfinished": early,
            "incomplete": incomplete(chosen),
            "stage": stage,
            "undrivable": undrivable(known),
        },
        provenance=provenance(known),
        primary=primary(mean[0], counted),
        learner=learner_checks(known.cells, passed, agents, plan),
        frontier=to_frontier(episodes),
        by_task=by_task(episodes, counted, {**COLUMNS, **SURROGATES}),
        drivers=drivers(at_home(episodes)),
        competence=verdicts,
        competent=by_task(episodes[Plan(settings=competent(verdicts)).covers(episodes)], counted, COLUMNS),
    )


def placebo(episodes: pd.DataFrame, plan: Plan = DEFAULT) -> pd.DataFrame:
    """The same analysis between two halves of the control agents; about 5 % of the effects should be "significant".

    Returns:
        A row a backend and outcome: comparisons, rejected (with p below alpha), p (of so many rejections or more if 5 %
        are expected) and the mean over settings of the plan's primary term: estimate, low, high.
    """
    control = episodes[episodes["arm"] == "control"]
    number = control.groupby(SETTING)["seed"].transform(lambda seeds: seeds.rank(method="dense") - 1)
    halves = control.assign(arm=(number % 2).map({0.0: "control", 1.0: "treatment"}))
    enough = number.groupby([control[column] for column in SETTING]).transform("max") >= LEAST - 1
    asked = [(outcome, term) for outcome in ("return", "crashed") for term in ("sum", plan.primary_term)]
    effects = contrasts(arms_of(halves[enough]), {BOTH: asked})
    by = ["backend", "outcome"]
    known = effects[(effects["term"] == "sum") & (effects["status"] == OK)]
    found = known.groupby(by, sort=False)["p"].agg(
        comparisons="size", rejected=lambda p: int((p < ALPHA).sum())
    )
    found["p"] = binom.sf(found["rejected"] - 1, found["comparisons"], ALPHA)
    primary = effects[effects["term"] == plan.primary_term]
    mean = combine(primary, by, equal_task_weights(primary, by))
    return found.reset_index().merge(mean[[*by, "estimate", "low", "high"]])


def policies(episodes: pd.DataFrame, outcomes: Iterable[str] = OUTCOMES) -> pd.DataFrame:
    """How every policy does, in every setting and traffic: trained agents by arm, and the others.

    Returns:
        A row a SETTING, policy, arm (empty for policies that are not trained) and traffic, in the grid's order: n and
        unit ("training seed" or "test episode"), the mean of every outcome and of length [steps], distance [m], arrived
        (share), density (other vehicles within 200 m), stopped (share of the steps) and progress (m per second that the
        episode was to last); "<outcome> se" over those units, NaN with one of them.
    """
    rows = at_home(episodes)
    arms = rows["arm"].where(rows["kind"] != "baseline", "").fillna("").astype(str)
    rows = rows.assign(arm=arms, unit=rows["seed"].where(arms != "", rows["scenario"]))
    columns = [*outcomes, *DESCRIPTIVE]
    group = [*SETTING, "policy", "arm", "traffic"]
    rows = rows.astype(dict.fromkeys(columns, float))
    grouped = rows.groupby([*group, "unit"], sort=False)[columns].mean().groupby(group, sort=False)
    errors = grouped[list(outcomes)].sem().add_suffix(" se")
    frame = grouped.mean().join(errors).reset_index()
    frame.insert(len(group), "n", grouped.size().to_numpy())
    frame.insert(len(group) + 1, "unit", np.where(frame["arm"] != "", "training seed", "test episode"))
    own = sorted({*frame["policy"]} - {LEARNER, *POLICIES})
    ranks = {name: rank for rank, name in enumerate((*ARMS, *EXTRA_ARMS, *POLICIES, *own))}
    frame["rank"] = frame["arm"].where(frame["arm"] != "", frame["policy"]).map(ranks)
    return in_order(frame, "backend", "task", "level", "rank", "traffic").drop(columns="rank")


def provenance(results: Results) -> dict[str, Any]:
    """Where the numbers come from.

    Returns:
        presets, versions (each with all values found), seconds (computing time of training and tests), cells (for each
        its files' checksums), hash (of these: equal hashes mean equal results).
    """
    versions: dict[str, set[str]] = {}
    for cell in results.cells.values():
        packages = (cell.get("provenance") or {}).get("packages", {})
        for name, version in {**packages, **cell["versions"]}.items():
            if version is not None:  # without a build tag, as in the cells' names
                versions.setdefault(name, set()).add(str(version).partition("+")[0])
    timings = [cell.get("timing", {}) for cell in results.cells.values()]
    files = {name: cell["files"] for name, cell in sorted(results.cells.items())}
    return {
        "presets": sorted({str(cell["key"]["profile"].get("preset")) for cell in results.cells.values()}),
        "versions": {name: sorted(found) for name, found in sorted(versions.items())},
        "seconds": sum(t.get("train_seconds", 0.0) + t.get("test_seconds", 0.0) for t in timings),
        "cells": files,
        "hash": digest_of(files),
    }


def as_json(analysis: Analysis) -> dict[str, Any]:
    """An analysis as strict JSON; a frame is {"columns": [...], "rows": [[...], ...]}.

    Numbers have twelve significant digits, since those beyond differ between processors; NaN is null.
    """
    value: dict[str, Any] = {"schema": SCHEMA}
    for part in fields(analysis):
        content = getattr(analysis, part.name)
        if isinstance(content, pd.DataFrame):
            table = content.drop(columns=WORKING_COLUMNS, errors="ignore")
            content = {"columns": list(table.columns), "rows": table.to_numpy(dtype=object).tolist()}
        value[part.name] = plain_json(content, digits=12)
    return value
