"""SUMO's own drivers against the stored episodes of highway-env, on the same scenarios: ``scorecard.py DIRECTORY``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parents[2]
if __name__ == "__main__":  # run as a file: import from the project, not from this folder
    sys.path[0] = str(ROOT)

from experiments.support.threads import limit_threads

limit_threads()

from experiments.study.grid import level_names
from experiments.validation import compare, jobs, record, reference
from experiments.validation.jobs import NATIVE, PATH
from sumo_env.tasks import TASKS
from tests.golden.regenerate import pretty

if TYPE_CHECKING:
    import pandas as pd

MEANS = {"crashed": "crash_rate", "return": "return", "traffic_speed": "traffic_speed", "headway": "headway"}
CELL = ["task", "level", "traffic"]


def scorecard(table: pd.DataFrame) -> dict[str, Any]:
    """The comparison of episodes of both engines, as README.md describes it."""
    both = compare.pairs(table, NATIVE.name, PATH.name)
    result: dict[str, Any] = {}
    for (task, level, traffic), rows in both.groupby(CELL):
        cell = f"level {level_names(task)[level - 1]}, {traffic}"
        egos = {"all": rows, **dict(list(rows.groupby("policy")))}
        result.setdefault(task, {})[cell] = {ego: line(part) for ego, part in egos.items()}
    return {task: result[task] for task in TASKS}


def line(both: pd.DataFrame) -> dict[str, Any]:
    """One ego's numbers: [SUMO, highway-env] of each mean, and how far single scenarios agree."""
    means = {
        name: [round(float(both[f"{measure}_{side}"].astype(float).mean()), 4) for side in "ab"]
        for measure, name in MEANS.items()
    }
    return {
        "scenarios": int(both["scenario"].nunique()),
        **means,
        "headway_distance": round(compare.headway_distance(both).difference, 4),
        "same_outcome": round(compare.agreement(both)[0], 4),
    }


def main(directory: Path) -> None:
    """Drive what is missing in `directory`, and write scorecard.json there."""
    import pandas as pd

    stored = reference.read()
    wanted = stored.provenance["scenarios"]
    size = jobs.Size(wanted["lowest"], wanted["others"], tuple(wanted["highway"]), 0)
    plan = [job for job in jobs.plan(tuple(TASKS), size, (NATIVE,)) if job.kind == "episodes"]
    jobs.run_all(plan, directory / "parts", 1, lambda count: print(f"{count} more parts driven", flush=True))
    driven = reference.collect(plan, directory / "parts", {})
    table = pd.concat([driven.episodes, stored.episodes], ignore_index=True)
    value = {
        "engines": ["SUMO's own drivers", "highway-env, variant path"],
        "versions": record.versions(),
        "reference": stored.provenance["versions"],
        "other_scenarios": compare.strangers(table, NATIVE.name, PATH.name),
        "tasks": scorecard(table),
    }
    (directory / "scorecard.json").write_text(pretty(value) + "\n")
    print(directory / "scorecard.json")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]))
