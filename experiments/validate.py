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

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from experiments.study import grid
from experiments.study.arms import TRAFFICS
from experiments.study.fingerprint import fingerprint
from experiments.study.verdict import SCHEMA
from experiments.support.errors import UserError, disk_error, run_command, unknown
from experiments.support.files import write_file, write_json
from experiments.support.provenance import provenance
from experiments.validation import checks, compare, page, parts, status
from experiments.validation.egos import CORE
from experiments.validation.parts import Engine

STORED_SCENARIOS = 24  # of each level, kept in the package for the check before a sweep
QUICK_SCENARIOS = 20
SIZE = {"highway-env": 10}  # scenarios in a part, by backend
VERSIONS = ("libsumo", "highway-env", "gymnasium", "numpy")


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
    return [
        replace(
            engine,
            egos=CORE if options.quick else (),
            stamps={task: fingerprint(engine.backend, task, dict(engine.config)) for task in tasks},
        )
        for engine in found
    ]


def validate(options: Options, console: Console, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Drive, compare, write the results into `options.out`, and return the content of validation.json.

    Raises:
        UserError: unknown task, level or backend; a part failed.
    """
    tasks = grid.choose_tasks(options.tasks or tuple(grid.TASKS))
    levels = grid.choose_levels(tasks, options.levels or None)
    scenarios = min(options.scenarios, QUICK_SCENARIOS) if options.quick else options.scenarios
    with console.status("taking fingerprints of the simulators"):
        driving = engines(options, tasks)
    folder = options.out / "parts"
    work = [
        part
        for engine in driving
        for part in parts.plan(
            [engine], levels, options.traffics, range(scenarios), SIZE.get(engine.backend, 50)
        )
    ]
    drive(work, folder, options.workers, console)
    table = parts.collect(work, folder)
    # the directory's name, not the machine's path to it
    named = [options.out.name if word == str(options.out) else word for word in arguments]
    origin = provenance()
    record = {
        "schema": SCHEMA,
        "command": shlex.join(["python", "experiments/validate.py", *named]),
        "quick": options.quick,
        "backend": options.backend,
        "reference": options.reference,
        "scenarios": scenarios,
        "versions": {**{name: origin["packages"][name] for name in VERSIONS}, "git": origin["git"]},
        "fingerprints": dict(driving[0].stamps),
        "strangers": compare.strangers(table, options.backend, checks.REFERENCE),
        "tasks": checks.scorecard(table, options.backend, {task: grid.level_names(task) for task in tasks}),
        "replica": checks.replica_checks(table),
    }
    write_json(options.out / "validation.json", record)
    write_file(options.out / "validation.html", page.render(record, page.draw(record, table)).encode())
    if options.update:
        status.store(record, table, STORED_SCENARIOS, CORE)
    return record


def drive(work: Sequence[parts.Part], folder: Path, workers: int, console: Console) -> None:
    """Drive what is not there yet, showing how far it has come and when it will be done."""
    left = [part for part in work if not (folder / part.file).exists()]
    with Progress(console=console, disable=not console.is_terminal) as progress:
        bar = progress.add_task("driving", total=sum(part.cost for part in left))

        def note(part: parts.Part) -> None:
            progress.update(bar, advance=part.cost, description=f"{part.engine.name}, {part.task}")
            if not console.is_terminal:
                console.print(part.file, highlight=False)

        parts.run(left, folder, workers, note)


def show(record: Mapping[str, Any], console: Console) -> None:
    """The scorecard in a few lines: how the checks came out, and every miss."""
    table = Table("task", "equivalent", "within", "missed", "verdict")
    for task, found in record["tasks"].items():
        counts = [str(value) for value in found["counts"].values()]
        colour = "green" if found["passed"] else "red"
        table.add_row(task, *counts, f"[{colour}]{page.WORDS[found['passed']]}")
    console.print(table)
    if misses := page.missed(record):
        rows = Table("missed", "traffic", "level", record["backend"], "highway-env", "difference", "margin")
        for c in misses:
            values = (page.number(c[key]) for key in ("sumo", "reference", "difference", "margin"))
            rows.add_row(f"{c['task']}: {c['name']} {c['ego']}", c["traffic"], c["level"], *values)
        console.print(rows)
    for task, found in (record["replica"] or {"tasks": {}})["tasks"].items():
        differing = f"{found['differing']} of {found['episodes']} episodes differ from highway-env"
        console.print(f"replica, {task}: {differing}")


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for name in ("scenarios", "workers", "one_in"):
        if getattr(options, name) < 1:
            raise UserError(f"--{name.replace('_', '-')} must be at least 1, not {getattr(options, name)}")
    for kind, words, known in (
        ("backend", (options.backend, options.reference), grid.BACKENDS),
        ("traffic", options.traffics, TRAFFICS),
    ):
        for word in words:
            if word not in known:
                raise unknown(kind, word, known)
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
