"""What is known, before training, of how close the simulator is to highway-env.

A full validation leaves two files here: `verdict.json` (what it found, by task, with the fingerprint of the
dynamics) and `reference.parquet` (highway-env's episodes of a few scenarios). Where the dynamics are still those,
the verdict holds; where not, the simulator is driven through the stored scenarios for about a minute.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.fingerprint import dynamics
from experiments.study.grid import level_names
from experiments.study.verdict import covers, every_check, of_results, read, summary, verdict, verdict_of
from experiments.support.files import write_json

if TYPE_CHECKING:
    import pandas as pd

HERE = Path(__file__).parent
VERDICT, STORED_REFERENCE = HERE / "verdict.json", HERE / "reference.parquet"
STORED_SCENARIOS = 24  # of each level
# The backend that a sweep has to know about; the others are highway-env, or tested against it.
VALIDATED = "sumo"


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
    fingerprints = {task: dynamics(backend, task) for task in tasks}
    known = of_results(out)
    if known is not None and covers(known, fingerprints):
        return known
    known = stored_verdict(fingerprints)
    if known is None:
        note("driving SUMO through highway-env's stored scenarios")
        known = quick_verdict(fingerprints, out / "validation", workers)
    if known is not None:
        write_json(out / "verdict.json", known)
    return known


def stored_verdict(fingerprints: Mapping[str, str]) -> dict[str, Any] | None:
    """The verdict of the last full validation on these tasks; None unless it is of the same versions and dynamics.

    Args:
        fingerprints: of the dynamics of each task now.
    """
    record = read(VERDICT)
    if record is None or not covers(record, fingerprints):
        return None
    tasks = {task: record["tasks"][task] for task in fingerprints}
    return {**record, "fingerprints": dict(fingerprints), "tasks": tasks}


def quick_verdict(fingerprints: Mapping[str, str], folder: Path, workers: int) -> dict[str, Any] | None:
    """Drive SUMO through the stored scenarios of these tasks and compare; None where nothing is stored.

    So few scenarios cannot show that a margin is kept; a check counts as missed only where its whole 90 % interval
    lies beyond the margin.
    """
    import pandas as pd

    from experiments.validation import parts
    from experiments.validation.checks import REFERENCE, scorecard

    if not STORED_REFERENCE.exists():
        return None
    stored = pd.read_parquet(STORED_REFERENCE)
    stored = stored[stored["task"].isin(list(fingerprints))]
    if set(stored["task"]) != set(fingerprints):
        return None
    number = int(stored["scenario"].max()) + 1
    levels = {str(task): sorted(set(rows)) for task, rows in stored.groupby("task")["level"]}
    engine = parts.Engine(VALIDATED, VALIDATED, egos=tuple(sorted(set(stored["ego"]))))
    work = parts.plan([engine], levels, tuple(dict.fromkeys(stored["traffic"])), range(number))
    driven = parts.run(work, folder, workers)
    table = pd.concat([driven, stored.assign(engine=REFERENCE)], ignore_index=True)
    tasks = scorecard(table, VALIDATED, {task: level_names(task) for task in fingerprints})
    for found in tasks.values():
        for _, _, item in every_check(found):
            if item["verdict"] == "missed" and not _surely(item):
                item["verdict"] = None
    return verdict(VALIDATED, f"{number} stored scenarios", summary(tasks), fingerprints)


def _surely(item: Mapping[str, Any]) -> bool:
    """Whether the whole interval of a check lies beyond its margin."""
    if (
        item["low"] is None or item["metric"] == "headway"
    ):  # a distance grows with noise and is never negative
        return False
    return bool(item["low"] > item["margin"] or item["high"] < -item["margin"])


def store(record: Mapping[str, Any], table: pd.DataFrame, egos: Sequence[str]) -> None:
    """Keep a full validation in the package: its verdict, and the reference's episodes of the first scenarios."""
    from experiments.validation.checks import REFERENCE
    from experiments.validation.episodes import COLUMNS

    write_json(VERDICT, verdict_of(record))
    first = table["scenario"] < STORED_SCENARIOS
    chosen = (table["engine"] == REFERENCE) & first & table["ego"].isin(list(egos))
    table.loc[chosen, list(COLUMNS)].to_parquet(STORED_REFERENCE, index=False, compression="zstd")
