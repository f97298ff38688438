"""Write the report of the cells that a sweep has stored.

    python experiments/report.py results/sumo-quick
    python experiments/report.py results/sumo-quick results/replica-quick    # others side by side with it

Nothing is trained: the report is a function of the stored cells, and may be written at any time, also while a
sweep is running (it then says what is missing). report.html is the first page, appendix.html has everything that is
not on it, report.md the first page's words and tables. analysis.json has all numbers; summary.csv (how every policy
drives) and effects.csv are its largest tables. The report shows the films that `watch.py` has written into the folder.

Exit status: 0 written, 2 the directory holds no results, or cannot be written.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tyro

from agents.plugins import load_object
from experiments.analysis.analysis import analyse, as_json
from experiments.analysis.effects import WORKING_COLUMNS, between
from experiments.analysis.plan import OUTCOMES, Outcome
from experiments.reporting.page import page, render
from experiments.study.design.levels import OwnTasks
from experiments.study.results.loaded import load
from experiments.study.results.schema import COLUMNS
from experiments.study.results.store import Store
from experiments.support.arguments import argument, command
from experiments.support.errors import UserError, in_words, writing
from experiments.support.files import write_file

REPORT, APPENDIX, TEXT, ANALYSIS = "report.html", "appendix.html", "report.md", "analysis.json"
SUMMARY, EFFECTS = "summary.csv", "effects.csv"


@dataclass(frozen=True)
class Options:
    """Write the report of the cells that a sweep has stored."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """The --out directory of a sweep."""
    others: Annotated[tuple[Path, ...], tyro.conf.Positional, argument("[OTHER ...]")] = ()
    """Other directories. Effects in the settings that all of them have are shown side by side."""
    tasks: OwnTasks = ()
    outcome: Annotated[tuple[str, ...], argument("FILE:NAME ...")] = ()
    """Also analyse outcomes of your own: objects of the class experiments.analysis.plan.Outcome with `of`
    (docs/developers/extending.md)."""
    pack: bool = False
    """Instead move the finished cells into parts, a file for each setting."""


def write_report(directory: Path, *others: Path, own: Mapping[str, Outcome] | None = None) -> Path:
    """Write the report of a directory's stored cells into it, with others side by side; returns report.html's path.

    Args:
        own: outcomes of the user's own to analyse as well, see `own_outcome`.

    Raises:
        UserError: no results there, or no permission to write.
    """
    directory = Path(directory)
    results = load(directory)
    analysis = analyse(results, own)
    further = {str(other): load(other) for other in others}
    beside = {name: (analyse(one), between(results, one)) for name, one in further.items()}
    with writing(directory):
        variables = page(results, analysis, beside, own)
        write_file(directory / ANALYSIS, (json.dumps(as_json(analysis), allow_nan=False) + "\n").encode())
        for name, table in (
            (SUMMARY, analysis.policies),
            (EFFECTS, analysis.effects.drop(columns=WORKING_COLUMNS)),
        ):
            write_file(directory / name, table.to_csv(index=False, float_format="%.10g").encode())
        for name in (TEXT, APPENDIX, REPORT):
            write_file(directory / name, render(variables, f"{name}.j2").encode())
    return directory / REPORT


@in_words()
def own_outcome(name: str) -> tuple[str, Outcome]:
    """An outcome of the user's own, "FILE:NAME", and what the report calls it: NAME.

    Raises:
        UserError: there is no such object, it is no outcome, or the name is taken.
    """
    outcome = load_object(name)
    key = name.rpartition(":")[2]
    if not isinstance(outcome, Outcome) or outcome.of is None:
        raise UserError(f"{name} must be an experiments.analysis.plan.Outcome with a function `of`")
    if key in {*OUTCOMES, *COLUMNS}:
        raise UserError(f"there is an outcome or a column {key!r} already; choose another name")
    return key, replace(outcome, of=partial(own_values, key, outcome.of))


def own_values(name: str, of: Callable[[pd.DataFrame], Any], episodes: pd.DataFrame) -> Any:
    """What a user's function makes of the episodes. Raises UserError unless it is one finite number for each."""
    try:
        values = np.asarray(of(episodes), dtype=float)
    except Exception as error:
        why = f"{type(error).__name__}: {error}".partition("\n")[0]
        raise UserError(f"the outcome {name} cannot be computed: {why}") from error
    if values.shape != (len(episodes),):
        raise UserError(
            f"the outcome {name} has the shape {values.shape}, not a number for each of {len(episodes)}"
        )
    for row in np.flatnonzero(~np.isfinite(values))[:1]:
        cell, traffic, scenario = episodes.iloc[row][["cell", "traffic", "scenario"]]
        raise UserError(
            f"the outcome {name} is {values[row]} in scenario {scenario} of {cell} in {traffic} traffic: every episode "
            "needs a finite number, for example 0 where nothing happened"
        )
    return values


def answer(directory: Path) -> str:
    """The answer of a report that was written: its Markdown down to the first table, as plain text."""
    text = (directory / TEXT).read_text(encoding="utf-8")
    words = text.partition("\n|")[0].partition("\n**Outcomes of your own")[0]
    return words.partition("\n\n")[2].replace("**", "").strip()


def print_report(directory: Path, *others: Path, own: Mapping[str, Outcome] | None = None) -> None:
    """Write the report, and print the answer and where it is. Raises UserError as `write_report` does."""
    path = write_report(directory, *others, own=own)
    print(answer(path.parent))
    print(f"report: {path}", flush=True)


def main(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    if options.pack:
        names = Store(options.directory).pack()
        print(f"{len(names)} cells moved into {Store(options.directory).parts}, and read back")
    else:
        own = dict(own_outcome(name) for name in options.outcome)
        print_report(options.directory, *options.others, own=own)
    return 0


if __name__ == "__main__":
    command(main, Options, __doc__)
