"""What is known about a version: for reports, from the small file that the last full validation left."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from experiments.study.grid import TASKS

LATEST = Path(__file__).parent / "latest.json"  # of the last full run, committed
Status = Literal["passed", "failed", "not validated"]


def validation_status(version: str, path: Path = LATEST) -> dict[str, Status]:
    """For each task whether this version of `sumo_env` passed its validation.

    Args:
        version: ``sumo_env.__version__`` of the results.
        path: a validation.json, or the summary of the latest one.

    Returns:
        "not validated" for every task where the file is missing, or is of another version.
    """
    status: dict[str, Status] = dict.fromkeys(TASKS, "not validated")
    if not path.exists():
        return status
    record: Mapping[str, Any] = json.loads(path.read_text())
    if record.get("versions", {}).get("sumo_env") != version:
        return status
    for task, result in record.get("tasks", {}).items():
        if task in status and result.get("passed") is not None:
            status[task] = "passed" if result["passed"] else "failed"
    return status


def summary(record: Mapping[str, Any]) -> dict[str, Any]:
    """The small file kept in the repository: what passed, and by name what did not."""
    tasks = {}
    for task, result in record["tasks"].items():
        checks = [check for level in result["levels"].values() for check in level["checks"]]
        checks += result["dynamics"]["checks"]
        missed = [c for c in checks if c["passed"] is False]
        tasks[task] = {
            "passed": result["passed"],
            "checks": sum(c["passed"] is not None for c in checks),
            "missed": [
                {name: c[name] for name in ("name", "level", "sumo", "highway_env", "difference", "margin")}
                for c in missed
            ],
        }
    return {
        "schema": record["schema"],
        "command": record["command"],
        "versions": record["versions"],
        "passed": record["passed"],
        "tasks": tasks,
    }
