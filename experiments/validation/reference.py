"""Stored episodes, scenes and lane changes of highway-env, so that a quick check of SUMO needs no highway-env."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.support.errors import UserError
from experiments.support.files import write_file
from experiments.support.files import write_json as write_plain_json
from experiments.validation.jobs import Job, parquet, read_json, write_json
from experiments.validation.stage import Motion

if TYPE_CHECKING:
    import pandas as pd

STORED = Path(__file__).parent / "reference"


@dataclass(frozen=True)
class Results:
    """What was driven.

    Attributes:
        episodes: one row an episode, column ``engine``.
        motions: engine -> name of the scene -> motion.
        placement: task -> lane -> error of placing a vehicle [m]; SUMO only.
        changes: engine -> level -> counts of each scenario.
        provenance: command, versions, date of the reference.
    """

    episodes: pd.DataFrame
    motions: Mapping[str, Mapping[str, Motion]]
    placement: Mapping[str, Mapping[str, float]]
    changes: Mapping[str, Mapping[int, Sequence[Mapping[str, float]]]]
    provenance: Mapping[str, Any]


def collect(jobs: Iterable[Job], folder: Path, provenance: Mapping[str, Any]) -> Results:
    """The results of finished jobs, no more scenarios than each asks for."""
    import pandas as pd

    tables = []
    motions: dict[str, dict[str, Motion]] = {}
    placement: dict[str, Mapping[str, float]] = {}
    changes: dict[str, dict[int, Sequence[Mapping[str, float]]]] = {}
    for job in jobs:
        path = folder / job.file
        if job.kind == "episodes":
            table = pd.read_parquet(path)
            tables.append(table[table["scenario"] < job.scenarios])
        elif job.kind == "scenes":
            record = read_json(path)
            own = motions.setdefault(job.engine, {})
            for name, motion in record["motions"].items():
                own[name] = Motion.from_dict(motion)
            if record["placement"]:
                placement[job.task] = record["placement"]
        else:
            changes.setdefault(job.engine, {})[job.level] = read_json(path)[: job.scenarios]
    return Results(pd.concat(tables, ignore_index=True), motions, placement, changes, provenance)


def write(results: Results, folder: Path) -> None:
    """Store a reference: three compressed files and where they come from."""
    folder.mkdir(parents=True, exist_ok=True)
    write_file(folder / "episodes.parquet", parquet(results.episodes))
    write_json(
        folder / "scenes.json.gz",
        {
            engine: {name: motion.as_dict() for name, motion in own.items()}
            for engine, own in results.motions.items()
        },
    )
    write_json(folder / "changes.json.gz", results.changes)
    write_plain_json(folder / "provenance.json", dict(results.provenance))


def read(folder: Path = STORED) -> Results:
    """A stored reference.

    Raises:
        UserError: there is none.
    """
    import pandas as pd

    if not (folder / "provenance.json").exists():
        raise UserError(f"no stored reference in {folder}: run validate.py without --quick to make one")
    return Results(
        pd.read_parquet(folder / "episodes.parquet"),
        {
            engine: {name: Motion.from_dict(motion) for name, motion in own.items()}
            for engine, own in read_json(folder / "scenes.json.gz").items()
        },
        {},
        {
            engine: {int(level): counts for level, counts in levels.items()}
            for engine, levels in read_json(folder / "changes.json.gz").items()
        },
        json.loads((folder / "provenance.json").read_text()),
    )
