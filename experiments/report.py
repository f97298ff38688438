"""Write report.html, summary.csv and analysis.json from the cells that a sweep has stored.

    python experiments/report.py results/sumo-quick
    python experiments/report.py results/sumo-quick --placebo

Nothing is simulated or trained: the report is a function of the stored cells, and may be written at any
time, also while a sweep is running (it then says what is missing). report.html is one file that needs
nothing else, summary.csv has one row a task, level, policy and traffic, analysis.json every number with the
cells that it rests on.

Exit status: 0 written, 2 the directory holds no results, or cannot be written.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder (statistics.py!)
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from agents.plugins import load_object
from experiments.analysis import wording
from experiments.analysis.analysis import analyse, summary_table
from experiments.analysis.plan import OUTCOMES, Outcome
from experiments.reporting.report_view import page
from experiments.study.evaluate import COLUMNS
from experiments.study.store import load
from experiments.support.errors import UserError, disk_error, run_command
from experiments.support.files import write_file, write_json

TEMPLATES = Path(__file__).with_name("templates")
REPORT, SUMMARY, ANALYSIS = "report.html", "summary.csv", "analysis.json"


@dataclass(frozen=True)
class Options:
    """Write report.html, summary.csv and analysis.json from the cells that a sweep has stored."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The --out directory of a sweep."""
    outcome: tuple[Annotated[str, tyro.conf.arg(metavar="FILE:NAME")], ...] = ()
    """Also analyse outcomes of your own: objects of the class experiments.analysis.plan.Outcome with `of`."""
    placebo: bool = False
    """Instead print the same analysis of control against control, where there is no effect."""


def write_report(directory: Path) -> Path:
    """Analyse the stored cells of a directory and write the three files into it.

    Returns:
        The path of report.html.

    Raises:
        UserError: no results there, a damaged cell, or no permission to write.
    """
    return _write(Path(directory))[0]


def _write(directory: Path) -> tuple[Path, dict[str, Any]]:
    results = load(directory, skip_damaged=True)
    analysis = analyse(results)
    path = directory / REPORT
    html = render(page(results, analysis))
    try:
        write_json(directory / ANALYSIS, analysis)
        write_file(directory / SUMMARY, summary_table(analysis).to_csv(index=False).encode())
        write_file(path, html.encode())
    except OSError as error:
        raise disk_error(error, directory) from None
    return path, analysis


def add_outcome(name: str) -> None:
    """Analyse an outcome of the user's own from now on, "FILE:NAME"; the report calls it NAME.

    Raises:
        UserError: there is no such object, it is no outcome, or the name is taken.
    """
    try:
        outcome = load_object(name)
    except ValueError as error:
        raise UserError(str(error)) from None
    key = name.rpartition(":")[2]
    if not isinstance(outcome, Outcome) or outcome.of is None:
        raise UserError(f"{name} must be an experiments.analysis.plan.Outcome with a function `of`")
    if key in {*OUTCOMES, *COLUMNS}:
        raise UserError(f"there is an outcome or a column {key!r} already; choose another name")
    OUTCOMES[key] = outcome


def render(variables: dict[str, Any]) -> str:
    """The report as one HTML text."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        name: getattr(wording, name)
        for name in ("number", "difference", "interval", "p_value", "count", "listing", "adjusted")
    }
    return environment.get_template("report.html.j2").render(variables)


def show(analysis: dict[str, Any]) -> None:
    """Print the answer and the verdicts."""
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    for headline in analysis["headlines"]:
        console.print(f"[bold]{headline['answer'].capitalize()}.[/bold]")
        console.print(" ".join(headline["text"]))
        table = Table(box=None, show_header=False, pad_edge=False)
        for claim in analysis["claims"]:
            if claim["backend"] == headline["backend"]:
                table.add_row(f"[bold]{claim['verdict']}[/bold]", claim["claim"])
        console.print(table)


def show_placebo(analysis: dict[str, Any]) -> None:
    """Print what comes of comparisons whose truth is "no effect"."""
    if not analysis["placebo"]:
        print("no placebo: a setting needs four control agents, to be dealt into two arms")
    for row in analysis["placebo"]:
        share = f"{row['rejected']} of {row['comparisons']} settings significant (about 5 % expected)"
        print(f"{wording.BACKENDS.get(row['backend'], row['backend'])}, {row['outcome']}, sum: {share}")
        if row["primary"]:
            found = wording.difference(row["primary"], row["outcome"])
            print(f"  primary question: {found}, p {wording.p_value(row['primary']['p'])}")
    if control := analysis["negative_control"]:
        print(f"negative control ({control['policy']} against itself): largest effect {control['largest']:g}")


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for name in options.outcome:
        add_outcome(name)
    if options.placebo:
        show_placebo(analyse(load(options.directory, skip_damaged=True)))
        return 0
    path, analysis = _write(options.directory)
    show(analysis)
    print(f"report: {path}")
    return 0


if __name__ == "__main__":
    run_command(main)
