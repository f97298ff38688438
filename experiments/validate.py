"""SUMO against highway-env on the same scenarios: how far apart they are, and whether that is within the margins.

    python experiments/validate.py --out results/validation            # drives highway-env too: see --help
    python experiments/validate.py --out /tmp/validation --quick       # two minutes, from the stored reference

Writes validation.json and validation.html. The same command run again goes on where it was stopped. Exit status: 0
all targets met, 1 some missed, 2 something has to be put right first. docs/validation.md says how to read them.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from experiments.study import grid
from experiments.support.errors import UserError, disk_error, run_command, unknown
from experiments.support.files import sha256_bytes, write_file, write_json
from experiments.validation import jobs, page, record, reference, status
from experiments.validation.jobs import Job, Size

ROOT = Path(__file__).resolve().parents[1]
# What parts depend on: those driven by other code are not used again. (That the scenarios are the same is checked.)
SOURCES = {"highway-env": ("experiments/backends",), "sumo": ("sumo_env", "networks")}
QUICK = Size(lowest=30, others=24, highway=(30, 12, 8), changes=6)


@dataclass(frozen=True)
class Options:
    """Compare SUMO with highway-env."""

    out: Path
    """Directory for validation.json and validation.html."""
    quick: bool = False
    """Drive SUMO only, in few scenarios, against the stored reference: two minutes."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TASK ...")] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    lowest: int = 200
    """Scenarios of the lowest traffic level; every ego drives each."""
    others: int = 200
    """Scenarios of each other level."""
    highway: tuple[int, int, int] = (200, 100, 60)
    """Scenarios of the highway's three levels, where highway-env is slowest."""
    traffics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TRAFFIC ...")] = ("regular", "risky")
    """Traffic to drive: regular (which has the targets), risky or both."""
    changes: int = 6
    """Scenarios in which lane-change decisions are examined, of the highway's first and third level each."""
    workers: int = 2
    """Number of processes."""
    update: bool = False
    """Store what highway-env drove, and the verdicts, in the package (experiments/validation/), to be committed."""

    @property
    def size(self) -> Size:
        """Scenarios a cell."""
        return QUICK if self.quick else Size(self.lowest, self.others, self.highway, self.changes)


def validate(options: Options, console: Console, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Drive, compare, write the results into `options.out`, and return the content of validation.json.

    Raises:
        UserError: unknown task, no reference, or one of other scenarios.
    """
    tasks = grid.choose_tasks(options.tasks or tuple(grid.TASKS))
    # the directory's name, not the machine's path to it
    named = [options.out.name if word == str(options.out) else word for word in arguments]
    command = shlex.join(["python", "experiments/validate.py", *named])
    size, traffics = options.size, options.traffics
    stored = reference.read() if options.quick else None
    if stored is not None:  # only what it can be compared with
        size = size.at_most(stored.provenance["scenarios"])
        traffics = tuple(name for name in traffics if name in set(stored.episodes["traffic"]))
    own = jobs.plan(tasks, size, (jobs.MATCHED, jobs.NATIVE), traffics)
    engines = (jobs.PATH, jobs.NOISE, jobs.CONNECTED, jobs.V0)
    theirs = [] if stored else jobs.plan(tasks, size, engines, traffics)
    parts = options.out / "parts"
    folders = {name: parts / f"{name}-{digest(*places)}" for name, places in SOURCES.items()}
    drive(theirs, folders["highway-env"], options.workers, console)
    drive(own, folders["sumo"], options.workers, console)
    driven = reference.collect(own, folders["sumo"], {})
    if stored is None:
        provenance = record.provenance_of(command, size)
        stored = reference.collect(theirs, folders["highway-env"], provenance)
        if options.update:
            reference.write(stored, reference.STORED)
    result = record.make(tasks, driven, stored, command, options.quick)
    write_json(options.out / "validation.json", result)
    drawn = page.draw(result, *record.for_figures(tasks, driven, stored))
    write_file(options.out / "validation.html", page.render(result, drawn).encode())
    if options.update and not options.quick:
        write_json(status.LATEST, status.summary(result))
    return result


def digest(*places: str) -> str:
    """Eight digits that change with the sources."""
    paths = []
    for place in places:
        paths += sorted([*(ROOT / place).rglob("*.py"), *(ROOT / place).rglob("*.net.xml")])
    return sha256_bytes(b"".join(path.read_bytes() for path in paths))[:8]


def drive(plan: Sequence[Job], folder: Path, workers: int, console: Console) -> None:
    """Drive what is planned, showing how far it has come."""
    if not plan:
        return
    name = "highway-env" if plan[0].is_reference else "SUMO"
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        left = [job for job in plan if not jobs.finished(job, folder)]
        bar = progress.add_task(f"driving {name}", total=len(plan), completed=len(plan) - len(left))
        jobs.run_all(left, folder, workers, lambda count: progress.advance(bar, count))


def show(result: dict[str, Any], console: Console) -> None:
    """The scorecard in a few lines: what passed, and every miss."""
    table = Table("task", "targets", "met", "equivalence shown", "verdict")
    missed = []
    for task, own in result["tasks"].items():
        checks = [c for level in own["levels"].values() for c in level["checks"]] + own["dynamics"]["checks"]
        targets = [c for c in checks if c["passed"] is not None]
        missed += [(task, c) for c in targets if not c["passed"]]
        met = sum(c["passed"] for c in targets)
        table.add_row(
            task, str(len(targets)), str(met), str(sum(bool(c["equivalent"]) for c in targets)),
            "[green]passed" if own["passed"] else "[red]not passed",
        )  # fmt: skip
    console.print(table)
    if result["other_scenarios"]:
        console.print(
            f"[yellow]{result['other_scenarios']} stored episodes are of scenarios that this version no longer draws "
            "and were left out: run without --quick to drive highway-env anew"
        )
    if missed:
        misses = Table("missed", "level", "SUMO", "highway-env", "difference", "margin", "noise floor")
        for task, c in missed:
            numbers = (c[name] for name in ("sumo", "highway_env", "difference", "margin", "noise_floor"))
            misses.add_row(f"{task}: {c['name']}, {c['metric']}", c["level"], *map(page.number, numbers))
        console.print(misses)


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for name in ("lowest", "others", "changes", "workers"):
        if getattr(options, name) < 1:
            raise UserError(f"--{name} must be at least 1, not {getattr(options, name)}")
    for traffic in options.traffics:
        if traffic not in grid.TRAFFICS:
            raise unknown("traffic", traffic, grid.TRAFFICS)
    console = Console()
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        result = validate(options, console, sys.argv[1:])
    except OSError as error:
        raise disk_error(error, options.out) from None
    show(result, console)
    console.print(f"report: {options.out / 'validation.html'}")
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    run_command(main)
