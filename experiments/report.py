"""Write report.html, and the same as Markdown, CSV and JSON, from the cells that a sweep has stored.

    python experiments/report.py results/sumo-quick
    python experiments/report.py results/sumo-quick results/replica-quick    # others beside it
    python experiments/report.py results/sumo-quick --placebo

Nothing is trained: the report is a function of the stored cells, and may be written at any time, also while a
sweep is running (it then says what is missing). report.html is one file that needs nothing else; report.md has
its words and tables; summary.csv has one row per task, level, policy and traffic, effects.csv one per task, level,
outcome and term, analysis.json every number with the cells that it rests on. For the
films in the report some stored agents drive a few of their test episodes again; the trajectories are kept in
showcase.json.

Exit status: 0 written, 2 the directory holds no results, or cannot be written.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import json
from dataclasses import dataclass
from typing import Annotated, Any

import tyro
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from agents.plugins import load_object
from experiments.analysis import wording
from experiments.analysis.analysis import SCHEMA, analyse, effect_table, summary_table
from experiments.analysis.plan import OUTCOMES, Outcome
from experiments.backends import make_env
from experiments.reporting.beside import beside
from experiments.reporting.report_view import page
from experiments.reporting.showcase import showcase
from experiments.study import store
from experiments.study.evaluate import COLUMNS
from experiments.study.results import load
from experiments.support.errors import UserError, disk_error, run_command
from experiments.support.files import write_file, write_json

TEMPLATES = Path(__file__).with_name("templates")
PUBLISHED = Path(__file__).resolve().parents[1] / "results" / "standard"
REPORT, TEXT, ANALYSIS = "report.html", "report.md", "analysis.json"
SUMMARY, EFFECTS = "summary.csv", "effects.csv"


@dataclass(frozen=True)
class Options:
    """Write report.html, and the same as Markdown, CSV and JSON, from the cells that a sweep has stored."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The --out directory of a sweep."""
    others: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="OTHER")] = ()
    """Others to show beside it; by default the published study, beside which its variants are shown."""
    outcome: tuple[Annotated[str, tyro.conf.arg(metavar="FILE:NAME")], ...] = ()
    """Also analyse outcomes of your own: objects of the class experiments.analysis.plan.Outcome with `of`."""
    pack: bool = False
    """Instead pack the cells of finished settings into a few tables; nothing is deleted."""
    placebo: bool = False
    """Instead print what the controls find: control against control, a rule against itself, a doubled penalty."""


def write_report(directory: Path, *others: Path) -> Path:
    """Analyse the stored cells of a directory and write the files of the report into it.

    Args:
        others: directories to show beside it; by default the published study, beside which its variants are shown.

    Returns:
        The path of report.html.

    Raises:
        UserError: no results there, or no permission to write.
    """
    return _write(Path(directory), others)[0]


def print_report(directory: Path, *others: Path) -> None:
    """Write the report, and print the answer and where it is. Raises UserError as `write_report` does."""
    path, analysis = _write(directory, others)
    show(analysis)
    print(f"report: {path}", flush=True)


def _write(directory: Path, others: Sequence[Path]) -> tuple[Path, dict[str, Any]]:
    results = load(directory, skip_damaged=True)
    analysis = analyse(results)
    named = [(_title(other, str(other)), analyse(load(other, skip_damaged=True))) for other in others]
    compared = beside(
        [(_title(directory, "This run"), analysis), *(named or _published(directory, analysis))]
    )
    path = directory / REPORT
    try:
        films = showcase(results, {entry["cell"] for entry in analysis["left_out"]}, make_env)
        variables = page(results, analysis, films) | {"beside": compared}
        write_json(directory / ANALYSIS, analysis)
        for name, table in ((SUMMARY, summary_table(analysis)), (EFFECTS, effect_table(analysis))):
            write_file(directory / name, table.to_csv(index=False).encode())
        write_file(directory / TEXT, render(variables, "report.md.j2").encode())
        write_file(path, render(variables).encode())
    except OSError as error:
        raise disk_error(error, directory) from None
    return path, analysis


def _published(directory: Path, analysis: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """What is shown beside a directory by itself: beside the published study its variants, beside others the study."""
    if directory.resolve() == PUBLISHED:
        folders = sorted(file.parent for file in PUBLISHED.parent.glob(f"*/{store.PUBLISHED}"))
    else:
        folders = [PUBLISHED]
    found = [(_title(folder, folder.name), _stored(folder / ANALYSIS)) for folder in folders]
    own = analysis["provenance"]["hash"]
    return [(title, other) for title, other in found if other and other["provenance"]["hash"] != own]


def _stored(path: Path) -> dict[str, Any] | None:
    """An analysis that is stored; None if it is not there, of another version, or damaged, which is said."""
    if not path.is_file():
        return None
    try:
        found: dict[str, Any] = json.loads(path.read_text())
    except ValueError:
        print(
            f"{path} is damaged and not shown: python experiments/report.py {path.parent} writes it again",
            file=sys.stderr,
        )
        return None
    return found if found.get("schema") == SCHEMA else None


def _title(directory: Path, otherwise: str) -> str:
    """What a directory is called: by the heading of its PUBLISHED.md."""
    path = directory / store.PUBLISHED
    heading = path.read_text().partition("\n")[0] if path.is_file() else ""
    return heading.removeprefix("#").strip() or otherwise


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


def render(variables: dict[str, Any], template: str = "report.html.j2") -> str:
    """The report as one HTML or Markdown text."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=template.endswith(".html.j2"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        name: getattr(wording, name)
        for name in ("number", "difference", "interval", "p_value", "count", "listing", "adjusted", "signed")
    }
    script = Markup((TEMPLATES / "player.js").read_text())
    return environment.get_template(template).render({**variables, "script": script})


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
    """Print what comes of comparisons whose truth is known."""
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

    for record in analysis["exploratory"]["positive_control"]:
        verdict = "found" if record["found"] else "not found"
        print(
            f"positive control (doubled penalty for crashes against control, regular traffic): {verdict}, "
            f"{wording.difference(record, record['outcome'])}, p {wording.p_value(record['p'])}"
        )


def report_placebo(directory: Path) -> None:
    """Print what the controls of the instrument find in a directory."""
    show_placebo(analyse(load(directory, skip_damaged=True)))


def pack_cells(directory: Path) -> None:
    """Pack the finished settings of a directory and say what was done."""
    from experiments.study.pack import pack

    names, unfinished = pack(directory)
    print(f"{len(names)} cells packed into the tables of {directory}, and read back equal")
    for setting, missing in unfinished.items():
        print(f"{setting} is not packed: {missing} of its cells are missing")
    if names:
        print(f"{directory / 'cells'} may be removed")


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for name in options.outcome:
        add_outcome(name)
    if options.pack:
        pack_cells(options.directory)
        return 0
    if options.placebo:
        report_placebo(options.directory)
        return 0
    print_report(options.directory, *options.others)
    return 0


if __name__ == "__main__":
    run_command(main)
