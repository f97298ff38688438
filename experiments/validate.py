"""A simulator against highway-env on the same scenarios: how far apart are they, and is that within the margins?

    python experiments/validate.py --out results/validation            # every level, 200 scenarios each
    python experiments/validate.py --out /tmp/validation --quick       # minutes

Writes validation.json and validation.html. The same command run again goes on where it was stopped. Exit status: 0
all margins kept, 1 some missed, 2 something has to be put right first. docs/validation.md says how to read them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.study.arms import TRAFFICS
from experiments.support.threads import limit_threads

limit_threads()

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from experiments.study import grid
from experiments.study.fingerprint import fingerprint
from experiments.study.verdict import summary
from experiments.support.errors import UserError, disk_error, run_command, unknown
from experiments.support.files import write_file, write_json
from experiments.support.provenance import provenance
from experiments.validation import checks, compare, mobil, page, parts, status
from experiments.validation.egos import CORE
from experiments.validation.parts import Engine

if TYPE_CHECKING:
    import pandas as pd

SCHEMA = 2
CHANGE_LEVELS = (1, 3)  # of the highway, whose lane changes are held against MOBIL
STORED_SCENARIOS = 24  # of each level, kept in the package for the check before a sweep
QUICK_SCENARIOS, QUICK_EGOS = 20, CORE


@dataclass(frozen=True)
class Options:
    """Compare a simulator with highway-env."""

    out: Path
    """Directory for validation.json and validation.html."""
    quick: bool = False
    """Few scenarios and egos, and the reference alone: neither its variants nor highway-env itself."""
    backend: str = "sumo"
    """The simulator that is compared."""
    reference: str = "replica"
    """The backend that computes highway-env's episodes: highway-env itself or its replica."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TASK ...")] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    levels: Annotated[tuple[int, ...], tyro.conf.arg(metavar="N ...")] = ()
    """Some traffic levels, 1 is the lightest (default: all)."""
    scenarios: int = 200
    """Scenarios of each level; every ego drives each."""
    traffics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TRAFFIC ...")] = ("regular", "risky")
    """Traffic to drive: regular, risky or both."""
    variants: bool = True
    """Whether the reference also drives its variants (v0, connected) and at 10 Hz; they are shown, not judged."""
    changes: int = 12
    """Scenarios in which lane changes are held against MOBIL, of the highway's first and third level each."""
    one_in: int = 20
    """Where another backend computes the reference, highway-env drives a random episode in so many again."""
    workers: int = 2
    """Number of processes."""
    update: bool = False
    """Store the verdict and a part of the reference in the package (experiments/validation/), to be committed."""


def engines(options: Options, tasks: Sequence[str]) -> list[Engine]:
    """Everything that drives, the compared simulator first."""
    path = {"variant": "path"}
    found = [Engine(options.backend, options.backend), Engine(checks.REFERENCE, options.reference, path)]
    if options.variants and not options.quick:
        found.append(Engine(checks.NOISE, options.reference, {**path, "simulation_frequency": 10}))
        found += [Engine(name, options.reference, {"variant": name}) for name in checks.VARIANTS]
    if options.reference != "highway-env" and not options.quick:
        found.append(Engine(checks.TRUTH, "highway-env", path, one_in=options.one_in))
    marks = {
        (e.backend, json.dumps(e.config)): {t: fingerprint(e.backend, t, dict(e.config)) for t in tasks}
        for e in found
    }
    quick = QUICK_EGOS if options.quick else ()
    return [replace(e, egos=quick, stamps=marks[e.backend, json.dumps(e.config)]) for e in found]


def validate(options: Options, console: Console, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Drive, compare, write the results into `options.out`, and return the content of validation.json.

    Raises:
        UserError: unknown task, level or backend; a process died.
    """
    tasks = grid.choose_tasks(options.tasks or tuple(grid.TASKS))
    levels = grid.choose_levels(tasks, options.levels or None)
    scenarios = min(options.scenarios, QUICK_SCENARIOS) if options.quick else options.scenarios
    with console.status("taking fingerprints of the simulators"):
        driving = engines(options, tasks)
    folder = options.out / "parts"
    episodes, changes = [], []
    for engine in driving:
        size = 10 if engine.backend == "highway-env" else 50
        episodes += parts.plan([engine], levels, options.traffics, range(scenarios), size)
        if engine.name in (options.backend, checks.REFERENCE) and "highway" in levels:
            number = min(options.changes, scenarios)
            changes += [mobil.Changes(engine, n, number) for n in CHANGE_LEVELS if n in levels["highway"]]
    drive([*episodes, *changes], folder, options.workers, console)
    table = parts.collect(episodes, folder)
    # the directory's name, not the machine's path to it
    named = [options.out.name if word == str(options.out) else word for word in arguments]
    record = {
        "schema": SCHEMA,
        "command": shlex.join(["python", "experiments/validate.py", *named]),
        "quick": options.quick,
        "backend": options.backend,
        "reference": options.reference,
        "scenarios": scenarios,
        "versions": versions(),
        "fingerprints": dict(driving[0].stamps),
        "strangers": compare.strangers(table, options.backend, checks.REFERENCE),
        "tasks": scorecard(table, options.backend, tasks),
        "lane_changes": lane_changes(changes, folder),
        "replica": checks.replica_checks(table),
    }
    write_json(options.out / "validation.json", record)
    write_file(options.out / "validation.html", page.render(record, page.draw(record, table)).encode())
    if options.update:
        status.store(record, table, STORED_SCENARIOS, CORE)
    return record


def drive(work: Sequence[parts.Work], folder: Path, workers: int, console: Console) -> None:
    """Do what is not there yet, showing how far it has come and when it will be done."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    left = [item for item in work if not (folder / item.file).exists()]
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("driving", total=sum(item.cost for item in left))

        def note(item: parts.Work) -> None:
            progress.update(bar, advance=item.cost, description=f"{item.engine.name}, {item.task}")
            if not console.is_terminal:
                console.print(item.file, highlight=False)

        parts.run(left, folder, workers, note)


def scorecard(table: pd.DataFrame, backend: str, tasks: Sequence[str]) -> dict[str, Any]:
    """The checks of every task, with how many came out how."""
    result = checks.scorecard(table, backend, {task: grid.level_names(task) for task in tasks})
    counts = summary(result)
    return {task: {**found, "counts": counts[task]["counts"]} for task, found in result.items()}


def lane_changes(work: Sequence[mobil.Changes], folder: Path) -> list[dict[str, Any]]:
    """A row for each simulator and level of the highway."""
    names = grid.level_names("highway")
    return [
        {
            "engine": "highway-env" if item.engine.name == checks.REFERENCE else item.engine.name,
            "level": names[item.level - 1],
            **mobil.shares(json.loads((folder / item.file).read_text())),
        }
        for item in work
    ]


def versions() -> dict[str, Any]:
    """What the results come from."""
    known = provenance()
    names = ("libsumo", "highway-env", "gymnasium", "numpy")
    return {**{name: known["packages"][name] for name in names}, "git": known["git"]}


def show(record: Mapping[str, Any], console: Console) -> None:
    """The scorecard in a few lines: how the checks came out, and every miss."""
    table = Table("task", "equivalent", "within", "missed", "verdict")
    for task, found in record["tasks"].items():
        counts = [str(value) for value in found["counts"].values()]
        table.add_row(
            task, *counts, ("[green]" if found["passed"] else "[red]") + page.WORDS[found["passed"]]
        )
    console.print(table)
    if misses := page.missed(record):
        rows = Table("missed", "traffic", "level", record["backend"], "highway-env", "difference", "margin")
        for c in misses:
            name = f"{c['task']}: {c['name']} {c['ego']}"
            values = (page.number(c[key]) for key in ("sumo", "reference", "difference", "margin"))
            rows.add_row(name, c["traffic"], c["level"], *values)
        console.print(rows)
    for task, found in (record["replica"] or {"tasks": {}})["tasks"].items():
        console.print(
            f"replica, {task}: {found['differing']} of {found['episodes']} episodes differ from highway-env"
        )


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for name in ("scenarios", "changes", "workers", "one_in"):
        if getattr(options, name) < 1:
            raise UserError(f"--{name.replace('_', '-')} must be at least 1, not {getattr(options, name)}")
    for backend in (options.backend, options.reference):
        if backend not in grid.BACKENDS:
            raise unknown("backend", backend, grid.BACKENDS)
    for traffic in options.traffics:
        if traffic not in TRAFFICS:
            raise unknown("traffic", traffic, TRAFFICS)
    console = Console()
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        record = validate(options, console, sys.argv[1:])
    except OSError as error:
        raise disk_error(error, options.out) from None
    show(record, console)
    console.print(f"report: {options.out / 'validation.html'}")
    return 0 if all(found["passed"] for found in record["tasks"].values()) else 1


if __name__ == "__main__":
    run_command(main, resumes=True)
