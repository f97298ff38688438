"""What is known, before training, of how close the simulator is to highway-env.

A full validation leaves two files here: `verdict.json` (what it found, by task, with the fingerprint of the
dynamics) and `reference.parquet` (highway-env's episodes of a few scenarios). Where the dynamics are still those,
the verdict holds; where not, the simulator is driven through the stored scenarios for about a minute.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.fingerprint import dynamics
from experiments.study.grid import level_names
from experiments.support.files import write_json

if TYPE_CHECKING:
    import pandas as pd

HERE = Path(__file__).parent
VERDICT, STORED_REFERENCE = HERE / "verdict.json", HERE / "reference.parquet"
SCHEMA = 2
VALIDATED = (
    "sumo"  # the backend that a sweep has to know about; the others are highway-env, or tested against it
)


def versions() -> dict[str, str]:
    """The packages that a verdict depends on, apart from what a fingerprint covers."""
    return {name: version(name) for name in ("libsumo",)}


def before_training(
    backend: str,
    tasks: Sequence[str],
    out: Path,
    workers: int = 1,
    note: Callable[[str], None] = lambda _: None,
) -> dict[str, Any] | None:
    """The verdict on a backend's tasks; also written to ``verdict.json`` in `out`, where the report looks for it.

    A verdict on these tasks that is there already, or a full validation.json, is not made again. None for a backend
    that needs no verdict, and where there is nothing to compare with.
    """
    if backend != VALIDATED:
        return None
    marks = {task: dynamics(backend, task) for task in tasks}
    known = of_results(out)
    if known is not None and known["backend"] == backend and _covers(known, marks):
        return known
    known = stored_verdict(backend, marks)
    if known is None:
        note("driving SUMO through highway-env's stored scenarios")
        known = quick_verdict(backend, marks, out / "validation", workers)
    if known is not None:
        write_json(out / "verdict.json", known)
    return known


def of_results(directory: Path) -> dict[str, Any] | None:
    """The verdict beside some results, None without one."""
    return read(directory / "verdict.json") or read(directory / "validation.json")


def read(path: Path) -> dict[str, Any] | None:
    """The verdict in a file, a full validation.json included; None if there is none that this version understands."""
    try:
        record = json.loads(path.read_text())
        if record["schema"] != SCHEMA:
            return None
        if any("traffics" in found for found in record["tasks"].values()):
            return verdict_of(record)
        return record
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _covers(record: Mapping[str, Any], marks: Mapping[str, str]) -> bool:
    known = record["fingerprints"]
    return record["versions"] == versions() and all(known.get(task) == mark for task, mark in marks.items())


def stored_verdict(backend: str, marks: Mapping[str, str], path: Path | None = None) -> dict[str, Any] | None:
    """The verdict of the last full validation on these tasks; None unless it is of the same versions and dynamics.

    Args:
        marks: task -> fingerprint of its dynamics now.
        path: file with the verdict; None for the one that the package ships.
    """
    record = read(path or VERDICT)
    if record is None or record["backend"] != backend or not _covers(record, marks):
        return None
    return {
        **record,
        "fingerprints": dict(marks),
        "tasks": {task: record["tasks"][task] for task in marks},
    }


def quick_verdict(
    backend: str, marks: Mapping[str, str], folder: Path, workers: int
) -> dict[str, Any] | None:
    """Drive the backend through the stored scenarios of these tasks and compare; None where nothing is stored.

    So few scenarios cannot show that a margin is kept; a check counts as missed only where its whole 90 % interval
    lies beyond the margin.
    """
    import pandas as pd

    from experiments.validation import parts
    from experiments.validation.checks import REFERENCE, scorecard

    stored = pd.read_parquet(STORED_REFERENCE) if STORED_REFERENCE.exists() else pd.DataFrame({"task": []})
    stored = stored[stored["task"].isin(list(marks))]
    if set(stored["task"]) != set(marks):
        return None
    number = int(stored["scenario"].max()) + 1
    levels = {task: sorted(set(stored.loc[stored["task"] == task, "level"])) for task in marks}
    engine = parts.Engine(backend, backend, stamps=marks, egos=tuple(sorted(set(stored["ego"]))))
    work = parts.plan([engine], levels, tuple(dict.fromkeys(stored["traffic"])), range(number), number)
    folder.mkdir(parents=True, exist_ok=True)
    parts.run(work, folder, workers, lambda _: None)
    table = pd.concat([parts.collect(work, folder), stored.assign(engine=REFERENCE)], ignore_index=True)
    tasks = scorecard(table, backend, {task: level_names(task) for task in marks})
    for result in tasks.values():
        for checks in (checks for levels in result["traffics"].values() for checks in levels.values()):
            for item in checks:
                if item["verdict"] == "missed" and not _surely(item):
                    item["verdict"] = None
    return _record(backend, f"{number} stored scenarios", summary(tasks), marks)


def _surely(item: Mapping[str, Any]) -> bool:
    """Whether the whole interval of a check lies beyond its margin."""
    if (
        item["low"] is None or item["metric"] == "headway"
    ):  # a distance is never negative and grows with noise
        return False
    return bool(item["low"] > item["margin"] or item["high"] < -item["margin"])


def summary(tasks: Mapping[str, Any]) -> dict[str, Any]:
    """What the verdict on each task says: passed, how many checks came out how, and by name those that were missed."""
    result = {}
    for task, found in tasks.items():
        every = [
            (traffic, level, item)
            for traffic, levels in found["traffics"].items()
            for level, checks in levels.items()
            for item in checks
        ]
        counts = {
            word: sum(item["verdict"] == word for _, _, item in every)
            for word in ("equivalent", "within", "missed")
        }
        keys = ("name", "ego", "sumo", "reference", "difference", "margin", "note")
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
    source = f"{record['scenarios']} scenarios of each level ({record['command']})"
    used = {name: record["versions"][name] for name in versions()}
    return {
        **_record(record["backend"], source, summary(record["tasks"]), record["fingerprints"]),
        "versions": used,
    }


def _record(backend: str, source: str, tasks: Mapping[str, Any], marks: Mapping[str, str]) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "backend": backend,
        "source": source,
        "versions": versions(),
        "fingerprints": dict(marks),
        "tasks": dict(tasks),
    }


def store(record: Mapping[str, Any], table: pd.DataFrame, scenarios: int, egos: Sequence[str]) -> None:
    """Keep a full validation in the package: its verdict, and the reference's episodes of the first scenarios."""
    from experiments.validation.checks import REFERENCE

    write_json(VERDICT, verdict_of(record))
    chosen = (table["engine"] == REFERENCE) & (table["scenario"] < scenarios) & table["ego"].isin(list(egos))
    table[chosen].drop(columns="engine").to_parquet(STORED_REFERENCE, index=False, compression="zstd")
