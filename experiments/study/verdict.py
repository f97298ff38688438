"""The verdict on SUMO that lies beside results: how close it is to highway-env, task by task.

`experiments/validate.py --update` stores it; a sweep keeps it with its results, where the report reads it.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from experiments.study.fingerprint import dynamics
from experiments.support.files import write_json

SCHEMA = 2
STORED = Path(__file__).resolve().parents[1] / "validation" / "verdict.json"


def versions() -> dict[str, str]:
    """The packages that a verdict depends on, apart from what a fingerprint covers."""
    return {name: version(name) for name in ("libsumo",)}


def of_results(directory: Path) -> dict[str, Any] | None:
    """The verdict beside some results; None if there is none that this version understands."""
    try:
        record: dict[str, Any] = json.loads((directory / STORED.name).read_text())
        return record if record["schema"] == SCHEMA else None
    except (OSError, ValueError, KeyError, TypeError):
        return None


def keep(backend: str, tasks: Sequence[str], out: Path) -> None:
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


def every_check(found: Mapping[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    """Traffic, level and content of all checks of a task."""
    return [
        (traffic, level, item)
        for traffic, levels in found["traffics"].items()
        for level, checks in levels.items()
        for item in checks
    ]


def summary(tasks: Mapping[str, Any]) -> dict[str, Any]:
    """What the verdict on each task says: passed, how many checks came out how, and by name those that were missed."""
    keys = ("name", "ego", "sumo", "reference", "difference", "margin", "note")
    result = {}
    for task, found in tasks.items():
        every = every_check(found)
        verdicts = [item["verdict"] for _, _, item in every]
        counts = {word: verdicts.count(word) for word in ("equivalent", "within", "missed")}
        missed = [
            {"traffic": traffic, "level": level, **{key: item[key] for key in keys}}
            for traffic, level, item in every
            if item["verdict"] == "missed"
        ]
        passed = not missed if sum(counts.values()) else None
        result[task] = {"passed": passed, "counts": counts, "missed": missed}
    return result


def verdict_of(record: Mapping[str, Any]) -> dict[str, Any]:
    """The verdict of a full validation, from the content of its validation.json."""
    return {
        "schema": SCHEMA,
        "backend": record["backend"],
        "source": f"{record['scenarios']} scenarios of each level ({record['command']})",
        "versions": {name: record["versions"][name] for name in versions()},
        "fingerprints": dict(record["fingerprints"]),
        "tasks": summary(record["tasks"]),
    }
