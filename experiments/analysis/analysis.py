"""Everything that the report says, as one value: a pure function of the stored cells."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import statistics
from experiments.analysis.effects import Record, effects, placebo
from experiments.analysis.gates import gates
from experiments.analysis.pooling import pooled, slopes
from experiments.analysis.tables import DESCRIPTIVE, OUTCOMES, PLACE, comparable, place_order, units
from experiments.analysis.verdicts import claims, headlines
from experiments.study.grid import ARMS, BASELINES, LEARNER, TRAFFICS
from experiments.study.store import Results
from experiments.support.files import canonical_json, sha256_bytes
from sumo_env.tasks import TASKS

SCHEMA = 1


def analyse(results: Results) -> dict[str, Any]:
    """Analyse the stored cells of a directory.

    Returns:
        A value that is strict JSON (no NaN, no infinity):
        headlines: answers in plain words, see `verdicts.headlines`.
        claims: see `verdicts.claims`. ate: see `effects.effects`. pooled, slopes: see `pooling`.
        placebo: see `effects.placebo`. gates: see `gates.gates`. policies: see `policies`.
        missing: cells that the last sweep asked for and that are not there; failed: why some of them failed.
        left_out: cells of other settings, not analysed. provenance: see `provenance`.
    """
    chosen, left_out = comparable(results)
    table = units(chosen.episodes)
    verdicts = gates(chosen.cells, chosen.gate_episodes)
    ate = effects(table, verdicts)
    trends = slopes(table, ate)
    means = pooled(table, ate)
    summary = policies(table, chosen.episodes)
    grid = {task: len(definition.levels) for task, definition in TASKS.items()}
    value = {
        "schema": SCHEMA,
        "headlines": headlines(ate, means, summary),
        "claims": claims(ate, trends, grid),
        "ate": ate,
        "pooled": means,
        "slopes": trends,
        "placebo": placebo(table),
        "gates": verdicts,
        "policies": summary,
        "missing": [name for name in results.expected if name not in results.cells],
        "failed": dict(results.failed),
        "left_out": left_out,
        "provenance": provenance(chosen),
    }
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
                tests = tests.assign(reward_per_step=tests["return"] / tests["length"])
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
    """The same value with plain types only; what is not a finite number becomes None."""
    if isinstance(value, Mapping):
        return {str(key): strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [strict(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
