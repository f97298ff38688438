"""The verdict on SUMO in a folder of results: how close it is to highway-env, task by task.

`experiments/validate.py --update` stores it; a sweep keeps it with its results, where the report reads it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from agents.schema import check
from experiments.study.design.fingerprint import dynamics
from experiments.support.files import read_json, write_json

SCHEMA = 2
RECORD = {"schema": (SCHEMA,), "versions": dict, "fingerprints": dict, "tasks": dict}
MISSED = {
    **dict.fromkeys(("traffic", "level", "name", "ego", "note"), str),
    "sumo": float,
    "reference": float,
}
VERDICT = {"counts": dict.fromkeys(("equivalent", "within", "missed"), int), "missed": [MISSED]}
STORED = Path(__file__).resolve().parents[2] / "validation" / "verdict.json"


def versions() -> dict[str, str]:
    """The packages that a verdict depends on, apart from what a fingerprint covers."""
    return {name: version(name) for name in ("libsumo",)}


def of_results(directory: Path) -> dict[str, Any] | None:
    """The verdict in a folder of results; None if there is none that this version understands."""
    try:
        record: dict[str, Any] = read_json(directory / STORED.name)
        check(record, RECORD)
        for task, verdict in record["tasks"].items():
            check(verdict, VERDICT, task)
    except (OSError, ValueError):
        return None
    return record


def copy_verdict(backend: str, tasks: Sequence[str], out: Path) -> None:
    """Copy the stored verdict on SUMO's tasks into `out`, unless a verdict on them is there.

    It has to be of the same versions and dynamics; on other simulators there is none.
    """
    if backend != "sumo":
        return
    now = {task: dynamics(backend, task) for task in tasks}
    own, stored = of_results(out), of_results(STORED.parent)
    if stored and covers(stored, now) and not (own and covers(own, now)):
        found = {task: stored["tasks"][task] for task in tasks}
        write_json(out / STORED.name, {**stored, "fingerprints": now, "tasks": found})


def covers(record: Mapping[str, Any], fingerprints: Mapping[str, str]) -> bool:
    """Whether a verdict is of these versions and of these dynamics, by task."""
    return record["versions"] == versions() and fingerprints.items() <= record["fingerprints"].items()
