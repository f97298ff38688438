"""Fit SUMO's drivers, and what a dose of risky traffic does, to highway-env, on other scenarios than validation's.

    python experiments/calibrate.py --out results/calibration      # hours
    python experiments/calibrate.py --out /tmp/calibration --tasks u-turn --trials 5 --scenarios 10

The same command run again goes on where it was stopped. There are three parts. `drivers` searches the calibrated
settings of SUMO's drivers (`Calibration`); `risk` searches the rates of risk events (`RiskRates`) and the ranges of
the drivers' parameters (`RiskRanges`). Both write what they found beside what is in force, judged on the scenarios of
validation. `doses` measures how often egos crash at every dose in both simulators, with and without events. Nothing
in the package is changed: what is worth it is written into the task's file by hand. Writes calibration.json,
doses.csv and doses.svg.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import pandas as pd
import tyro
from rich.console import Console
from rich.table import Table

from experiments.calibration import objectives
from experiments.calibration.search import search
from experiments.calibration.spaces import DRIVERS, RISK, Space, changes_of_risk, present_risk
from experiments.study import grid
from experiments.study.fingerprint import fingerprint
from experiments.support.errors import UserError, disk_error, run_command, unknown
from experiments.support.files import sha256_bytes, write_file, write_json
from experiments.validation import parts
from experiments.validation.checks import REFERENCE
from experiments.validation.egos import CORE
from experiments.validation.parts import Engine
from sumo_env.tasks import TASKS

PARTS = ("drivers", "risk", "doses")
FITTED = 1000  # number of the first scenario used for fitting; validation's begin at 0
WITHOUT_EVENTS = "sumo, parameters alone"


@dataclass(frozen=True)
class Options:
    """Fit SUMO's drivers and the dose of risk to highway-env."""

    out: Path
    """Directory for the results."""
    parts: tuple[str, ...] = PARTS
    """What to do: drivers, risk, doses."""
    tasks: tuple[str, ...] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn (default: all)."""
    reference: str = "replica"
    """The backend that computes highway-env's episodes; highway-env itself cannot be used for risk."""
    trials: int = 40
    """Evaluations of each search."""
    scenarios: int = 60
    """Scenarios of each level for an evaluation."""
    test: int = 100
    """Scenarios of each level on which the outcome is judged."""
    workers: int = 2
    """Number of processes."""


def engines(options: Options, task: str) -> tuple[Engine, Engine]:
    """SUMO, and what it is fitted to."""
    path = {"variant": "path"}
    theirs = fingerprint(options.reference, task, path)
    return (
        Engine("sumo", "sumo", stamps={task: fingerprint("sumo", task, {})}),
        Engine(REFERENCE, options.reference, path, stamps={task: theirs}),
    )


class Fit:
    """What is done for one task."""

    def __init__(self, options: Options, task: str) -> None:
        self.options, self.task = options, task
        self.levels = tuple(range(1, len(grid.level_names(task)) + 1))
        self.sumo, self.reference = engines(options, task)

    def drive(
        self, engines: Sequence[Engine], levels: Sequence[int], traffics: Sequence[str], scenarios: range
    ) -> pd.DataFrame:
        """The episodes of some engines; those of the reference are driven once."""
        size = -(-len(scenarios) // self.options.workers)
        work = parts.plan(engines, {self.task: levels}, traffics, scenarios, size)
        parts.run(work, self.options.out / "parts", self.options.workers, lambda _: None)
        return parts.collect(work, self.options.out / "parts")

    def drivers_distance(self, settings: dict[str, Any], levels: Sequence[int], scenarios: range) -> float:
        """The distance of SUMO's regular traffic with these settings."""
        engines = [replace(self.sumo, calibration=settings, egos=CORE), replace(self.reference, egos=CORE)]
        return objectives.drivers(self.drive(engines, levels, ("regular",), scenarios), "sumo", self.task)

    def risk_distance(self, settings: dict[str, Any], levels: Sequence[int], scenarios: range) -> float:
        """How far a dose with these rates of events and ranges of parameters is from what it shall do."""
        risk = changes_of_risk(TASKS[self.task], settings)
        engines = [replace(engine, risk=risk, egos=objectives.EGOS) for engine in (self.sumo, self.reference)]
        return objectives.doses(
            self.drive(engines, levels, objectives.SEARCHED, scenarios), "sumo", self.task
        )

    def search(self, part: str, note: Callable[[int, float], None]) -> dict[str, Any] | None:
        """Search the settings of SUMO's drivers, or of risk; what is in force and what was found, judged alike.

        Drivers are fitted at the lowest and the highest level and judged at all; risk at the lowest level.
        """
        if part == "drivers":
            space, distance, present = DRIVERS[self.task], self.drivers_distance, TASKS[self.task].calibration
            start, judged = {name: asdict(present)[name] for name in space}, self.levels
            fitted = tuple(dict.fromkeys((self.levels[0], self.levels[-1])))
        else:
            space, distance = RISK[self.task], self.risk_distance
            start, judged = {name: present_risk(TASKS[self.task])[name] for name in space}, (1,)
            fitted = (1,)
        if not space:
            return None
        training = range(FITTED, FITTED + self.options.scenarios)
        study = search(
            space,
            lambda settings: distance(settings, fitted, training),
            start,
            self.options.trials,
            self.options.out / self._journal(part, space),
            note,
        )
        judging = range(self.options.test)
        return {
            "present": start,
            "found": study.best_params,
            "training": {"present": study.trials[0].value, "found": study.best_value},
            "judged": {
                "present": distance(start, judged, judging),
                "found": distance(study.best_params, judged, judging),
            },
            "trials": [{"settings": trial.params, "distance": trial.value} for trial in study.trials],
        }

    def _journal(self, part: str, space: Space) -> str:
        """File of a search, by what makes evaluations comparable: both simulators, the scenarios and the space."""
        marks = (engine.stamps[self.task] for engine in (self.sumo, self.reference))
        searched = sha256_bytes(repr(sorted(space.items())).encode())[:8]
        return "-".join([part, self.task, *marks, str(self.options.scenarios), searched]) + ".journal"

    def doses(self) -> pd.DataFrame:
        """Responses to every dose at the lowest level, in both simulators and without events."""
        none = dict.fromkeys(("cut_in", "brake", "surge"), 0.0)
        silent = replace(self.sumo, name=WITHOUT_EVENTS, risk=none)
        engines = [replace(engine, egos=objectives.EGOS) for engine in (self.sumo, silent, self.reference)]
        return objectives.responses(self.drive(engines, (1,), objectives.DOSES, range(self.options.test)))


def calibrate(options: Options, console: Console) -> dict[str, Any]:
    """Do the parts for every task and write the results; returns the content of calibration.json."""
    result: dict[str, Any] = {name: getattr(options, name) for name in ("scenarios", "test", "reference")}
    tables = []
    for task in grid.choose_tasks(options.tasks or tuple(grid.TASKS)):
        fit, result[task] = Fit(options, task), {}
        for part in ("drivers", "risk"):
            if part in options.parts:
                with console.status(f"{task}: {part}") as status:

                    def note(
                        done: int, best: float, status: Any = status, words: str = f"{task}: {part}"
                    ) -> None:
                        status.update(f"{words}, {done} of {options.trials}, distance {best:.3f}")

                    result[task][part] = fit.search(part, note)
        if "doses" in options.parts:
            with console.status(f"{task}: doses"):
                tables.append(fit.doses())
        write_json(options.out / "calibration.json", result)
    if tables:
        from experiments.calibration.figures import dose_response

        table = pd.concat(tables, ignore_index=True)
        write_file(options.out / "doses.csv", table.round(4).to_csv(index=False).encode())
        drawn = dose_response(table, ("sumo", REFERENCE, WITHOUT_EVENTS))
        write_file(options.out / "doses.svg", drawn.encode())
    return result


def show(result: dict[str, Any], console: Console) -> None:
    """What was found, beside what is in force."""
    table = Table("task", "part", "setting", "present", "found", "distance, training", "distance, judged")
    for task in grid.TASKS:
        for part, found in result.get(task, {}).items():
            words = [task, part]
            for name, value in (found or {"found": {}})["found"].items():
                pairs = [found[key] for key in ("training", "judged")] if words[0] else []
                distances = [f"{pair['present']:.3f} -> {pair['found']:.3f}" for pair in pairs]
                table.add_row(*words, name, f"{found['present'][name]:.3g}", f"{value:.3g}", *distances)
                words = ["", ""]
    if table.row_count:
        console.print(table)


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for part in options.parts:
        if part not in PARTS:
            raise unknown("part", part, PARTS)
    if options.reference not in grid.BACKENDS:
        raise unknown("backend", options.reference, grid.BACKENDS)
    if options.reference == "highway-env" and set(options.parts) & {"risk", "doses"}:
        raise UserError(
            "only the drivers can be fitted to highway-env itself: use --parts drivers or --reference replica"
        )
    console = Console()
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        result = calibrate(options, console)
    except OSError as error:
        raise disk_error(error, options.out) from None
    show(result, console)
    return 0


if __name__ == "__main__":
    run_command(main, resumes=True)
