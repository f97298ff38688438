"""validation.json: the checks of every task and level, put together from what was driven."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import sumo_env
from experiments.study.grid import level_names
from experiments.support.provenance import provenance
from experiments.validation import changes as lane_changes
from experiments.validation import compare, dynamics_checks
from experiments.validation.compare import Difference
from experiments.validation.jobs import MATCHED, NATIVE, NOISE, PATH, Size
from experiments.validation.margins import CHANGES
from experiments.validation.reference import Results
from experiments.validation.scorecard import Check, check, passed, task_record
from experiments.validation.stage import Motion

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = 1


def versions() -> dict[str, Any]:
    """What decides about the results."""
    known = provenance()
    packages = known["packages"]
    return {
        "sumo_env": sumo_env.__version__,
        "sumo": f"libsumo {packages['libsumo']}",
        "highway-env": packages["highway-env"],
        "gymnasium": packages["gymnasium"],
        "numpy": packages["numpy"],
        "git": known["git"],
    }


def provenance_of(command: str, size: Size) -> dict[str, Any]:
    """Where a reference comes from."""
    scenarios = {
        "lowest": size.lowest,
        "others": size.others,
        "highway": list(size.highway),
        "changes": size.changes,
    }
    return {"command": command, "versions": versions(), "git": versions()["git"], "scenarios": scenarios}


def make(tasks: Sequence[str], driven: Results, stored: Results, command: str, quick: bool) -> dict[str, Any]:
    """The content of validation.json.

    Args:
        driven: by SUMO.
        stored: by highway-env.
    """
    import pandas as pd

    table = pd.concat([driven.episodes, stored.episodes], ignore_index=True)
    records = {}
    for task in tasks:
        records[task] = task_record(
            table, task, few_vehicles(task, driven, stored),
            change_checks(driven, stored) if task == "highway" else {},
        )  # fmt: skip
    verdicts = [record["passed"] for record in records.values()]
    return {
        "schema": SCHEMA,
        "command": command,
        "quick": quick,
        "versions": versions(),
        "reference": {
            name: stored.provenance.get(name) for name in ("command", "git", "versions", "scenarios")
        },
        "other_scenarios": compare.strangers(
            table, MATCHED.name, PATH.name
        ),  # the reference is of another version
        "passed": all(verdict is True for verdict in verdicts),
        "tasks": records,
    }


def few_vehicles(task: str, driven: Results, stored: Results) -> list[Check]:
    """Checks of the deterministic scenes of a task."""
    own, theirs, coarse = (
        {name: motion for name, motion in results.motions.get(engine, {}).items() if f" | {task} | " in name}
        for results, engine in ((driven, MATCHED.name), (stored, PATH.name), (stored, NOISE.name))
    )
    own = {name: motion for name, motion in own.items() if name in theirs}
    return dynamics_checks.checks(own, theirs, coarse, driven.placement[task])


def change_checks(driven: Results, stored: Results) -> dict[str, list[Check]]:
    """Checks of lane-change decisions by name of the highway's level; SUMO's own model without targets."""
    found: dict[str, list[Check]] = {}
    for level, counts in stored.changes.get(PATH.name, {}).items():
        theirs = lane_changes.shares(counts)
        noise = stored.changes.get(NOISE.name, {}).get(level)
        name = level_names("highway")[level - 1]
        for engine, label in ((MATCHED.name, ""), (NATIVE.name, ", traffic model sumo")):
            ours = driven.changes[engine][level]
            own = lane_changes.shares(ours)
            for metric, title, unit in (
                ("changes_valid", "lane changes that satisfy MOBIL", "share"),
                ("valid_made", "MOBIL's chances that are taken", "share"),
                ("change_rate", "lane changes", "1/vehicle-minute"),
            ):
                margin = CHANGES[metric] if engine == MATCHED.name else None
                bound = None
                if margin is not None:
                    bound = margin.value * (theirs[metric] if margin.relative else 1.0)
                difference = Difference(
                    own[metric], theirs[metric], own[metric] - theirs[metric], None, None, len(ours)
                )
                floor = None if noise is None else lane_changes.shares(noise)[metric] - theirs[metric]
                found.setdefault(name, []).append(
                    check(title + label, metric, difference, level=name, unit=unit, margin=margin, bound=bound,
                          noise=floor)
                )  # fmt: skip
    return found


def for_figures(
    tasks: Sequence[str], driven: Results, stored: Results
) -> tuple[pd.DataFrame, dict[str, Mapping[str, Motion]], dict[str, Motion]]:
    """What `page.draw` draws: paired episodes of both simulators, the scenes, and that of the artefact."""
    import pandas as pd

    table = pd.concat([driven.episodes, stored.episodes], ignore_index=True)
    table = table[table["engine"].isin((MATCHED.name, PATH.name)) & table["task"].isin(tasks)]
    pair = ["task", "level", "traffic", "policy", "scenario"]
    table = table[table.groupby(pair)["engine"].transform("nunique") == 2]
    motions: dict[str, Mapping[str, Motion]] = {
        "sumo": {k: m for k, m in driven.motions[MATCHED.name].items() if k != "artefact"},
        "highway-env": {k: m for k, m in stored.motions[PATH.name].items() if k != "artefact"},
    }
    every = {**driven.motions, **stored.motions}
    shown = {name: own["artefact"] for name, own in every.items() if "artefact" in own and name != NOISE.name}
    return table, motions, shown if "u-turn" in tasks else {}


__all__ = ["SCHEMA", "for_figures", "make", "passed", "provenance_of", "versions"]
