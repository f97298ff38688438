"""Everything that the report says, as one value: a pure function of the stored cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import plan as plans
from experiments.analysis import statistics
from experiments.analysis.effects import Record, effects
from experiments.analysis.exploratory import exploratory
from experiments.analysis.gates import GATES, gates
from experiments.analysis.headline import headlines
from experiments.analysis.placebo import negative_control, placebo
from experiments.analysis.plan import OUTCOMES
from experiments.analysis.pooling import failures, pooled, slopes
from experiments.analysis.sensitivity import learnt, second_batch, sensitivity
from experiments.analysis.tables import (
    DESCRIPTIVE,
    PLACE,
    comparable,
    complete,
    duplicates,
    fitting,
    place_order,
    settings,
    split,
    units,
    with_outcomes,
    without,
)
from experiments.analysis.verdicts import claims
from experiments.study.arms import ARMS, TRAFFICS
from experiments.study.grid import BASELINES, LEARNER
from experiments.study.results import Results
from experiments.support.files import canonical_json, sha256_bytes
from sumo_env.tasks import TASKS

SCHEMA = 2


def analyse(results: Results, version: int = plans.DEFAULT.version) -> dict[str, Any]:
    """Analyse the stored cells of a directory.

    Args:
        version: of the plan.

    Returns:
        A value that is strict JSON (no NaN, no infinity):
        plan, plan_hash: see `plan`. headlines: the answer in plain words, see `headline.headlines`.
        claims: see `verdicts.claims`. ate: see `effects.effects`. pooled, slopes, failures: see `pooling`.
        sensitivity, learnt, second_batch: see `sensitivity`. placebo, negative_control: see `placebo`.
        exploratory: see `exploratory.exploratory`.
        gates: see `gates.gates`. policies: see `policies`.
        missing: cells that the last sweep asked for and that are not there; failed: why some of them failed;
        damaged: cells that cannot be read, with the reason; incomplete: cells whose tables lack something;
        duplicates: cells that hold the same agent. left_out: cells of other settings, not analysed.
        provenance: see `provenance`.
    """
    whole, incomplete = complete(results)
    main, extra = split(whole)
    chosen, left_out = comparable(main)
    further = fitting(extra, chosen)
    left_out += [
        {"cell": name, "reason": "no agents of both arms with its settings to compare with"}
        for name in extra.cells
        if name not in further.cells
    ]
    plan = plans.plan_of(
        (str(cell["key"]["profile"].get("preset")) for cell in chosen.cells.values()), version
    )
    data = plans.as_data(plan, GATES)
    episodes = with_outcomes(chosen.episodes, chosen.cells)
    pairs = settings(episodes)
    verdicts = gates(chosen.cells, chosen.gate_episodes)
    grid = {task: len(definition.levels) for task, definition in TASKS.items()}
    ate = effects(pairs, verdicts, plan)
    trends = slopes(pairs, grid, plan)
    value = {
        "schema": SCHEMA,
        "plan": data,
        "plan_hash": plans.digest(data),
        "claims": claims(ate, trends, grid, plan),
        "ate": ate,
        "pooled": pooled(pairs, plan),
        "failures": failures(pairs, verdicts, plan),
        "slopes": trends,
        "sensitivity": sensitivity(pairs, verdicts, plan),
        "learnt": learnt(pairs, verdicts, plan),
        "second_batch": second_batch(pairs, ate, plan),
        "placebo": placebo(pairs, plan),
        "negative_control": negative_control(episodes),
        "exploratory": exploratory(chosen, further, plan),
        "gates": verdicts,
        "policies": policies(units(episodes), episodes),
        "missing": [name for name in results.expected if name not in results.cells],
        "failed": dict(results.failed),
        "damaged": dict(results.damaged),
        "incomplete": incomplete,
        "duplicates": duplicates(chosen),
        "left_out": left_out,
        "provenance": provenance(without(whole, {entry["cell"] for entry in left_out})),
    }
    value["headlines"] = headlines(value, grid, plan)
    return strict(value)


def policies(table: pd.DataFrame, episodes: pd.DataFrame) -> list[Record]:
    """How every policy does, in every task, level and traffic; trained agents by arm, and the baselines.

    Returns:
        Records with backend, task, level, level_name, policy, arm (None for baselines), traffic, n and unit
        (trained
        agents: "training seed", baselines: "test episode"), mean and se (by name of outcome; se over those
        units, None with one of them, and only of outcomes), iqm (interquartile mean over seeds; None for
        baselines), cells.
    """
    result = []
    names = [*OUTCOMES, *DESCRIPTIVE]
    by_cell = dict(tuple(episodes.groupby(["cell", "traffic"], sort=False))) if len(episodes) else {}
    order: dict[tuple[str, str | None], int] = {(LEARNER, arm): number for number, arm in enumerate(ARMS)}
    own = sorted(set(table["policy"]) - {LEARNER, *BASELINES})  # policies that the user brought
    order |= {(policy, None): len(order) + number for number, policy in enumerate((*BASELINES, *own))}
    table = table.assign(arm=table["arm"].where(table["kind"] == "agent", None).astype(object))
    groups = table.groupby([*PLACE, "policy", "arm"], sort=False, dropna=False)
    for (backend, task, level, level_name, policy, arm), rows in groups:
        arm = arm if isinstance(arm, str) else None
        for traffic in TRAFFICS:
            mean = {name: float(rows[f"{name} {traffic}"].mean()) for name in names}
            if arm is None:
                tests = by_cell[rows["cell"].iloc[0], traffic]
                samples = {name: tests[name].astype(float) for name in OUTCOMES}
            else:
                samples = {name: rows[f"{name} {traffic}"] for name in OUTCOMES}
            n = len(samples["return"])
            se = {name: float(x.std(ddof=1) / math.sqrt(n)) if n > 1 else None for name, x in samples.items()}
            result.append(
                {
                    "backend": backend,
                    "task": task,
                    "level": int(level),
                    "level_name": level_name,
                    "policy": policy,
                    "arm": arm,
                    "traffic": traffic,
                    "n": n,
                    "unit": "training seed" if arm else "test episode",
                    "mean": mean,
                    "se": se,
                    "iqm": {name: statistics.iqm(x) for name, x in samples.items()} if arm else None,
                    "cells": sorted(rows["cell"]),
                }
            )
    return sorted(result, key=lambda r: (*place_order(r), order[r["policy"], r["arm"]], r["traffic"]))


def summary_table(analysis: Mapping[str, Any]) -> pd.DataFrame:
    """The policies of an analysis as a flat table: one row a task, level, policy, arm and traffic."""
    keys = (*PLACE, "policy", "arm", "traffic", "n", "unit")
    return pd.DataFrame(
        [
            {
                **{key: record[key] for key in keys},
                **record["mean"],
                **{f"{name}_se": value for name, value in record["se"].items()},
                "cells": " ".join(record["cells"]),
            }
            for record in analysis["policies"]
        ]
    )


def effect_table(analysis: Mapping[str, Any]) -> pd.DataFrame:
    """The treatment effects of an analysis as a flat table: one row per task, level, outcome and term."""
    keys = (*PLACE, "outcome", "term", "family", "estimate", "se", "low", "high", "p", "p_adjusted", "status")
    arms = ("treatment", "control")
    return pd.DataFrame(
        [
            {
                **{key: record[key] for key in keys},
                **{f"seeds_{arm}": n for arm, n in zip(arms, record["seeds"], strict=True)},
                **{f"mean_{arm}": record[f"mean_{arm}"] for arm in arms},
                "cells": " ".join(record["cells"]),
            }
            for record in analysis["ate"]
        ]
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


def strict(value: Any) -> Any:
    """The same value with plain types only; what is not a finite number becomes None.

    Numbers have twelve significant digits: those beyond differ between processors.
    """
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return float(f"{value:.12g}") if isinstance(value, float) else value
