"""SUMO against highway-env on the same scenarios: how far apart are they, and is that within the margins?

    python experiments/validate.py --out results/validation            # every level, 200 scenarios each
    python experiments/validate.py --out results/validation --quick       # minutes

The replica computes highway-env's episodes, and highway-env itself drives a random part of them again. Writes
validation.json and validation.html. The same command run again continues where it was stopped. A check is missed where
its whole 90 % interval lies outside of the margin. Exit status: 0 no margin is missed, 1 some are, 2 something has to
be put right first. docs/validation.md says how to read them.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Annotated, Any

import pandas as pd

from experiments.study.design.cell import installed
from experiments.study.design.fingerprint import check_dynamics, dynamics
from experiments.study.design.levels import StudyTasks, choose_levels, choose_tasks
from experiments.study.design.traffic import TRAFFICS
from experiments.study.design.verdict import STORED
from experiments.support.arguments import argument, as_typed, command
from experiments.support.errors import UserError, check_least, writing
from experiments.support.files import read_json, write_file, write_json
from experiments.support.provenance import provenance
from experiments.validation import checks, episodes
from experiments.validation.episodes import AGENTS, CORE, Engine

QUICK_SCENARIOS = 20
STYLE = Path(__file__).parent / "templates" / "report.css"
JUDGED = Path(__file__).parents[1] / "results" / "validation.csv"  # each check with a verdict
COUNTS, OUTSIDE = "Checks of each task", "Estimates outside of their margins"
WHERE = ["task", "traffic", "level", "name", "ego", "unit", "verdict", "sumo", "reference", "difference"]
WHERE += ["low", "high", "margin", "n", "note"]


@dataclass(frozen=True)
class Options:
    """Compare SUMO with highway-env."""

    out: Path
    """Directory for validation.json and validation.html."""
    quick: bool = False
    """Few scenarios and egos, and neither variants of highway-env, highway-env itself nor trained agents."""
    tasks: StudyTasks = ()
    levels: Annotated[tuple[int, ...], argument("N ...", "all")] = ()
    """Some traffic levels, 1 is the lightest."""
    scenarios: int = 200
    """Scenarios of each level and traffic; every ego drives each."""
    one_in: int = 20
    """highway-env itself drives one of so many episodes again, drawn at random."""
    workers: int = 2
    """Number of processes."""
    update: bool = False
    """Store the verdict on these tasks in the package (experiments/validation/verdict.json), and each check in
    results/validation.csv, to be committed."""


def engines(options: Options) -> list[Engine]:
    """Everything that drives, the compared simulator first."""
    path, egos = {"variant": "path"}, CORE if options.quick else ()
    judged = [Engine(checks.SUMO, "sumo", egos=egos), Engine(checks.REFERENCE, "replica", path, egos=egos)]
    if options.quick:
        return judged
    judged += [replace(engine, egos=AGENTS) for engine in judged]
    variants = [Engine(name, "replica", config) for name, config in checks.VARIANTS.items()]
    return [*judged, *variants, Engine(checks.TRUTH, "highway-env", path, one_in=options.one_in)]


def validate(options: Options, arguments: Sequence[str] = ()) -> dict[str, Any]:
    """Drive, compare, write the results into `options.out`, and return the content of validation.json.

    Raises:
        UserError: unknown task or level; a simulator has other dynamics than its name says; a part failed.
    """
    if options.update and (options.quick or options.levels):
        raise UserError("--update stores what is said of whole tasks: leave out --quick and --levels")
    tasks = choose_tasks(options.tasks)
    levels = choose_levels(tasks, options.levels)
    scenarios = min(options.scenarios, QUICK_SCENARIOS) if options.quick else options.scenarios
    check_dynamics((backend, task) for backend in ("sumo", "replica") for task in tasks)
    work = episodes.plan(engines(options), levels, tuple(TRAFFICS), range(scenarios))
    table = episodes.run(work, options.out / "parts", options.workers)
    # the directory's name, not the machine's path to it
    named = [options.out.name if word == str(options.out) else word for word in arguments]
    found = checks.scorecard(table)
    source = f"{scenarios} scenarios of each level ({as_typed('validate', named)})"
    versions = {"libsumo": installed("libsumo")}  # all else is in the fingerprint
    verdict = {
        task: {"source": source, "versions": versions, "fingerprint": dynamics("sumo", task), **own}
        for task, own in checks.summary(found, tasks).items()
    }
    replica = checks.replica_checks(table)
    about = {"source": source, "provenance": provenance()}
    record = {**about, "tasks": verdict, "checks": found, "replica": replica}
    write_json(options.out / "validation.json", record)
    write_file(options.out / "validation.html", page(record).encode())
    if options.update:
        write_json(STORED, {**read_json(STORED), **verdict})
        judged = pd.DataFrame([check for check in found if check["verdict"]])
        write_file(JUDGED, judged.to_csv(index=False, float_format="%.6g").encode())
    return record


def tables(record: Mapping[str, Any]) -> dict[str, pd.DataFrame]:
    """What was found, by title: counts, estimates outside, what highway-env itself drove again, and every check.

    The columns after `note` are what other variants of highway-env differ by from the reference.
    """
    found = pd.DataFrame(record["checks"])
    found = found[WHERE + [name for name in checks.VARIANTS if name in found]]
    counts = {task: {"all kept": own["passed"], **own["counts"]} for task, own in record["tasks"].items()}
    return {
        COUNTS: pd.DataFrame(counts).T,
        OUTSIDE: found[found["verdict"].isin(checks.OUTSIDE)].dropna(axis="columns", how="all"),
        "Episodes of the replica that highway-env drove again": pd.DataFrame(record["replica"]).T,
        "Every check": found,
    }


def page(record: Mapping[str, Any]) -> str:
    """validation.html, from the content of validation.json: one file, nothing loaded from elsewhere."""
    about = f"{record['source']}; {record['provenance']['packages']}"
    parts = [
        f"<h2>{title}</h2><div class=scroll>{table.to_html(na_rep='', float_format='{:.3g}'.format)}</div>"
        for title, table in tables(record).items()
        if len(table)
    ]
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><title>SUMO against highway-env</title>"
        f"<style>{STYLE.read_text()}</style><h1>SUMO against highway-env</h1><p>{escape(about)}</p>"
        f"{''.join(parts)}</html>\n"
    )


def main(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    check_least(options, scenarios=1, workers=1, one_in=1)
    with writing(options.out):
        record = validate(options, sys.argv[1:])
    for title in (COUNTS, OUTSIDE):
        table = tables(record)[title]
        print(f"{title}\n{table.to_string() if len(table) else 'nothing'}\n")
    print(f"every check: {options.out / 'validation.html'}")
    return 0 if all(found["passed"] is not False for found in record["tasks"].values()) else 1


if __name__ == "__main__":
    command(main, Options, __doc__, resumes=True)
