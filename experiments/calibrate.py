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

from experiments.support.threads import limit_threads

limit_threads()

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import pandas as pd
import tyro
from rich.console import Console
from rich.table import Table

from experiments.calibration import doses, drivers
from experiments.calibration.search import Settings, search
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
TRAINING = 1000  # number of the first scenario used for fitting; validation's begin at 0
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


class Fit:
    """Drives what a task's calibration needs and remembers it in files."""

    def __init__(self, options: Options, task: str) -> None:
        self.options, self.task = options, task
        self.levels = tuple(range(1, len(grid.level_names(task)) + 1))
        self.ends = tuple(dict.fromkeys((self.levels[0], self.levels[-1])))
        self._folder = options.out / "parts"
        self._marks: dict[str, str] = {}

    def reference(self, **changes: Any) -> Engine:
        """The engine that is aimed at."""
        config = {"variant": "path"}
        return Engine(
            REFERENCE,
            self.options.reference,
            config,
            stamps=self._stamps(self.options.reference, config),
            **changes,
        )

    def sumo(self, **changes: Any) -> Engine:
        """SUMO with changed settings."""
        return Engine("sumo", "sumo", stamps=self._stamps("sumo", {}), **changes)

    def _stamps(self, backend: str, config: dict[str, Any]) -> dict[str, str]:
        if backend not in self._marks:
            self._marks[backend] = fingerprint(backend, self.task, config)
        return {self.task: self._marks[backend]}

    def drive(
        self, engines: Sequence[Engine], levels: Sequence[int], traffics: Sequence[str], scenarios: range
    ) -> pd.DataFrame:
        """The episodes of some engines; those of the reference are driven once."""
        size = -(-len(scenarios) // self.options.workers)
        work = parts.plan(engines, {self.task: levels}, traffics, scenarios, size)
        parts.run(work, self._folder, self.options.workers, lambda _: None)
        return parts.collect(work, self._folder)

    @property
    def training(self) -> range:
        """Numbers of the scenarios of an evaluation."""
        return range(TRAINING, TRAINING + self.options.scenarios)

    @property
    def judging(self) -> range:
        """Numbers of the scenarios that validation uses as well."""
        return range(self.options.test)

    # -- drivers -----------------------------------------------------------------------------------------------

    def drivers_distance(self, settings: Settings, levels: Sequence[int], scenarios: range) -> float:
        """The distance of SUMO's regular traffic with these settings."""
        engines = [self.sumo(calibration=settings, egos=CORE), self.reference(egos=CORE)]
        return drivers.distance(self.drive(engines, levels, ("regular",), scenarios), "sumo", self.task)

    def fit_drivers(self, note: Callable[[int, float], None]) -> dict[str, Any] | None:
        """Search the settings of SUMO's drivers at the lowest and the highest level; judge them at all."""
        present = asdict(TASKS[self.task].calibration)
        return self._fit("drivers", DRIVERS[self.task], present, self.ends, self.drivers_distance, note)

    # -- risk --------------------------------------------------------------------------------------------------

    def risk_distance(self, settings: Settings, levels: Sequence[int], scenarios: range) -> float:
        """How far a dose with these rates of events and ranges of parameters is from what it shall do."""
        risk = changes_of_risk(TASKS[self.task], settings)
        engines = [make(risk=risk, egos=doses.EGOS) for make in (self.sumo, self.reference)]
        return doses.distance(self.drive(engines, levels, doses.SEARCHED, scenarios), "sumo", self.task)

    def fit_risk(self, note: Callable[[int, float], None]) -> dict[str, Any] | None:
        """Search the rates of risk events and the ranges of parameters at the lowest level."""
        present = present_risk(TASKS[self.task])
        return self._fit("risk", RISK[self.task], present, (1,), self.risk_distance, note, judged=(1,))

    def _fit(
        self, part: str, space: Space, present: Settings, levels: Sequence[int],
        distance: Callable[[Settings, Sequence[int], range], float], note: Callable[[int, float], None],
        judged: Sequence[int] = (),
    ) -> dict[str, Any] | None:  # fmt: skip
        if not space:
            return None
        start = {name: present[name] for name in space}
        journal = self.options.out / f"{part}-{self.task}-{'-'.join(self._key(space))}.journal"
        study = search(
            space,
            lambda settings: distance(settings, levels, self.training),
            start,
            self.options.trials,
            journal,
            note,
        )
        judged = judged or self.levels
        return {
            "present": start,
            "found": study.best_params,
            "training": {"present": study.trials[0].value, "found": study.best_value},
            "judged": {
                "present": distance(start, judged, self.judging),
                "found": distance(study.best_params, judged, self.judging),
            },
            "trials": [{"settings": trial.params, "distance": trial.value} for trial in study.trials],
        }

    def _key(self, space: Space) -> list[str]:
        """What makes evaluations comparable: both simulators, the scenarios and what is searched."""
        marks = [self._stamps("sumo", {}), self.reference().stamps]
        searched = sha256_bytes(repr(sorted(space.items())).encode())[:8]
        return [*(mark[self.task] for mark in marks), str(self.options.scenarios), searched]

    # -- doses -------------------------------------------------------------------------------------------------

    def measure_doses(self) -> pd.DataFrame:
        """Responses to every dose at the lowest level, in both simulators and without events."""
        none = dict.fromkeys(("cut_in", "brake", "surge"), 0.0)
        silent = self.sumo(risk=none, egos=doses.EGOS).named(WITHOUT_EVENTS)
        engines = [self.sumo(egos=doses.EGOS), silent, self.reference(egos=doses.EGOS)]
        return doses.responses(self.drive(engines, (1,), doses.DOSES, self.judging))


def calibrate(options: Options, console: Console) -> dict[str, Any]:
    """Do the parts for every task and write the results; returns the content of calibration.json."""
    result: dict[str, Any] = {
        "scenarios": options.scenarios,
        "test": options.test,
        "reference": options.reference,
    }
    tables = []
    for task in grid.choose_tasks(options.tasks or tuple(grid.TASKS)):
        fit = Fit(options, task)
        found: dict[str, Any] = {}
        for part, function in (("drivers", fit.fit_drivers), ("risk", fit.fit_risk)):
            if part in options.parts:
                with console.status(f"{task}: {part}") as status:
                    found[part] = function(
                        lambda done, best, words=f"{task}: {part}": status.update(  # type: ignore[misc]
                            f"{words}, {done} of {options.trials} evaluations, distance {best:.3f}"
                        )
                    )
        if "doses" in options.parts:
            with console.status(f"{task}: doses"):
                tables.append(fit.measure_doses())
        result[task] = found
        write_json(options.out / "calibration.json", result)
    if tables:
        from experiments.calibration.figures import dose_response

        table = pd.concat(tables, ignore_index=True)
        write_file(options.out / "doses.csv", table.round(4).to_csv(index=False).encode())
        write_file(options.out / "doses.svg", dose_response(table, WITHOUT_EVENTS).encode())
    return result


def show(result: dict[str, Any], console: Console) -> None:
    """What was found, beside what is in force."""
    table = Table("task", "part", "setting", "present", "found", "distance, training", "distance, judged")
    for task in grid.TASKS:
        for part, found in result.get(task, {}).items():
            if found is None:
                continue
            for number, (name, value) in enumerate(found["found"].items()):
                texts = [
                    f"{found[key]['present']:.3f} -> {found[key]['found']:.3f}"
                    for key in ("training", "judged")
                ]
                place = (task, part) if not number else ("", "")
                distances = texts if not number else ("", "")
                table.add_row(*place, name, f"{found['present'][name]:.3g}", f"{value:.3g}", *distances)
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
