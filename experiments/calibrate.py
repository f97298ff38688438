"""Fit SUMO's drivers, and what a dose of risky traffic does, to highway-env, on other scenarios than validation's.

    python experiments/calibrate.py --out results/calibration      # hours
    python experiments/calibrate.py --out results/calibration --tasks u-turn --trials 5 --scenarios 10

The same command run again continues where it was stopped. There are three parts:

drivers   searches the calibrated settings of SUMO's drivers (`Calibration`)
risk      searches the rates of risk events (`RiskRates`) and the lower ends of the ranges of the drivers' parameters
          (`RiskRanges`)
doses     measures how often egos crash at every dose, with and without events, on SUMO and, if it has the task, on the
          replica

The first two compare the present settings with those that were found, on the scenarios of validation. They change no
file of the package: copy the settings into the task's file by hand. Writes calibration.json and doses.csv.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import optuna
import pandas as pd
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution

from experiments.backends import has, require
from experiments.study.design.fingerprint import check_dynamics
from experiments.study.design.levels import choose_tasks, level_names
from experiments.study.design.sheet import GRID, Between, Space, sheet
from experiments.study.design.traffic import AT_A_DOSE
from experiments.support.arguments import TaskNames, command
from experiments.support.errors import writing
from experiments.support.files import write_file, write_json
from experiments.validation import episodes
from experiments.validation.checks import MARGINS, REFERENCE, level_checks
from experiments.validation.episodes import CORE, Engine
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import Task

FITTED = 1000  # number of the first scenario used for fitting; validation's begin at 0
EGOS = ("careful", "idm", "idle")  # of the doses
DOSES = tuple(AT_A_DOSE)
SEARCHED = ("regular", "dose50", "risky")  # enough to see a rise
RISE = 0.10  # least rise of the careful ego's crash rate from dose 0 to dose 1
AIM = (0.15, 0.25)  # of that rise, well within .10 to .30
WITHOUT_EVENTS = "sumo, parameters alone"
SUMO, HIGHWAY_ENV = Engine("sumo", "sumo"), Engine(REFERENCE, "replica", {"variant": "path"})


@dataclass(frozen=True)
class Options:
    """Fit SUMO's drivers and the dose of risk to highway-env (its replica)."""

    out: Path
    """Directory for the results."""
    parts: tuple[Literal["drivers", "risk", "doses"], ...] = ("drivers", "risk", "doses")
    """What to do."""
    tasks: TaskNames = ()
    trials: int = 40
    """Evaluations of each search."""
    scenarios: int = 100
    """Scenarios of each level for an evaluation. The outcome is judged on as many others."""
    workers: int = 2
    """Number of processes."""


def present_risk(task: Task) -> dict[str, Any]:
    """Rates of events and ranges of parameters that are in force; of a range, its lower end."""
    both = asdict(task.risk_rates) | asdict(task.risk_ranges)
    return {name: value[0] if isinstance(value, tuple) else value for name, value in both.items()}


def risk_options(task: Task, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a search as `reset` takes them: a lower end becomes a range up to the present upper end."""
    options: dict[str, dict[str, Any]] = {"risk_rates": {}, "risk_ranges": {}}
    for name, value in settings.items():
        present = getattr(task.risk_ranges, name, None)  # None: it is a rate
        kind = "risk_rates" if present is None else "risk_ranges"
        options[kind][name] = (value, present[1]) if isinstance(present, tuple) else value
    return options


def drivers_distance(table: pd.DataFrame, task: str) -> float:
    """0 if SUMO does in each level what the reference does, about 1 at the margins.

    The share of episodes that end otherwise is a term, too. It is no target (crossings are decided by centimetres), but
    it is much less noisy than a difference of crash rates, and guides the search where those cannot.

    Args:
        table: episodes of both, in regular traffic, by the egos of `episodes.CORE`.
    """
    found = pd.DataFrame(
        {"level": level, **item}
        for level, rows in table.groupby("level")
        for item in level_checks(rows, task, "regular")
    )
    margins = found["margin"].mask(found["metric"] == "same_outcome", 1.0)
    shares = (found["difference"].abs() / margins)[margins > 0]
    by_metric = shares.groupby([found["level"], found["metric"]]).mean()
    return float(by_metric.groupby("level").mean().mean())


def responses(table: pd.DataFrame) -> pd.DataFrame:
    """Crash rate, time to crash and length of the episodes by engine, task, traffic and ego."""
    return table.groupby(["engine", "task", "traffic", "ego"], sort=False, as_index=False).agg(
        crash_rate=("crashed", "mean"),
        time_to_crash=("crash_time", "mean"),
        length=("length", "mean"),
        episode_return=("return", "mean"),
        episodes=("crashed", "size"),
    )


def dose_distance(table: pd.DataFrame, task: str) -> float:
    """0 if a dose does what it shall, about 1 at the margins.

    At dose 1 the careful ego shall crash .10 to .30 more often than at dose 0, less at smaller doses, and careful, IDM
    and idle egos alike in both simulators.

    Args:
        table: episodes of SUMO and the reference in SEARCHED, by EGOS.
    """
    rates = responses(table).pivot(index=["traffic", "ego"], columns="engine", values="crash_rate")
    rates = rates.reindex(pd.MultiIndex.from_product([SEARCHED, EGOS], names=rates.index.names))
    total = float((rates["sumo"] - rates[REFERENCE]).abs().mean()) / MARGINS["crashed"][0]
    if not sheet(task).rises:  # only the likeness counts
        return total
    careful = rates.xs("careful", level="ego")
    rise = careful.iloc[-1] - careful.iloc[0]
    outside = (AIM[0] - rise).clip(lower=0) + (rise - AIM[1]).clip(lower=0)
    falls = careful.diff().clip(upper=0).abs().sum()
    return total + float((outside + falls).sum()) / RISE


def minimise(
    space: Space, objective: Callable[[dict[str, Any]], float], start: Mapping[str, Any], trials: int
) -> optuna.Study:
    """Look for the settings of the least `objective` by tree-structured Parzen estimators.

    They cope with noise, with switches and with few evaluations. The same arguments give the same evaluations.

    Args:
        start: settings that are evaluated first, those of today.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)
    sampler = optuna.samplers.TPESampler(seed=0, n_startup_trials=10, multivariate=True)
    study = optuna.create_study(sampler=sampler)
    study.enqueue_trial(dict(start))
    searched: dict[str, BaseDistribution] = {
        name: FloatDistribution(*values[:2], log=values.log)
        if isinstance(values, Between)
        else CategoricalDistribution(values)
        for name, values in space.items()
    }
    for number in range(trials):
        trial = study.ask(searched)
        study.tell(trial, found := objective(trial.params))
        print(f"evaluation {number + 1} of {trials}: {found:.3g}", flush=True)
    return study


def search(options: Options, part: str, task: str) -> dict[str, Any] | None:
    """Search the settings of SUMO's drivers, or of risk; what is in force and what was found, with their distances.

    Drivers are fitted at the lowest and the highest level and judged at all; risk at the lowest level.
    """
    drivers = part == "drivers"
    space = sheet(task).drivers if drivers else sheet(task).risk
    if not space:
        return None
    present = asdict(TASKS[task].calibration) if drivers else present_risk(TASKS[task])
    judged = range(1, len(level_names(task)) + 1) if drivers else range(1, 2)

    def distance(settings: dict[str, Any], first: int, levels: Sequence[int]) -> float:
        if drivers:
            own, theirs = {"calibration": settings}, {}
        else:
            own = theirs = risk_options(TASKS[task], settings)
        egos = CORE if drivers else EGOS
        engines = [replace(SUMO, options=own, egos=egos), replace(HIGHWAY_ENV, options=theirs, egos=egos)]
        traffics = ("regular",) if drivers else SEARCHED
        work = episodes.plan(engines, {task: levels}, traffics, range(first, first + options.scenarios))
        table = episodes.run(work, options.out / "parts", options.workers)
        return (drivers_distance if drivers else dose_distance)(table, task)

    start, fitted = {name: present[name] for name in space}, sorted({judged[0], judged[-1]})
    study = minimise(space, lambda settings: distance(settings, FITTED, fitted), start, options.trials)
    return {
        name: {"settings": own, "training": training, "judged": distance(own, 0, judged)}
        for name, own, training in (
            ("present", start, study.trials[0].value),
            ("found", study.best_params, study.best_value),
        )
    }


def doses(options: Options, task: str) -> pd.DataFrame:
    """Responses to every dose at the lowest level, on SUMO with and without events, and on the replica if it can."""
    none = {"risk_rates": dict.fromkeys(("cut_in", "brake", "surge"), 0.0)}
    silent = replace(SUMO, name=WITHOUT_EVENTS, options=none)
    engines = [
        replace(engine, egos=EGOS) for engine in (SUMO, silent, HIGHWAY_ENV) if has(engine.backend, task)
    ]
    work = episodes.plan(engines, {task: (1,)}, DOSES, range(options.scenarios))
    return responses(episodes.run(work, options.out / "parts", options.workers))


def calibrate(options: Options) -> dict[str, Any]:
    """Do the parts for every task and write the results; returns the content of calibration.json."""
    tasks = choose_tasks(options.tasks or tuple(GRID))
    for task in tasks if {*options.parts} != {"doses"} else ():
        require(HIGHWAY_ENV.backend, task)
    check_dynamics((engine.backend, task) for engine in (SUMO, HIGHWAY_ENV) for task in tasks)
    result: dict[str, Any] = {"scenarios": options.scenarios}
    tables = []
    for task in tasks:
        result[task] = {}
        for part in options.parts:
            print(f"{task}: {part}")
            if part == "doses":
                tables.append(doses(options, task))
            elif found := search(options, part, task):
                result[task][part] = found
                print(found)
        write_json(options.out / "calibration.json", result)
    if tables:
        table = pd.concat(tables, ignore_index=True).round(4)
        write_file(options.out / "doses.csv", table.to_csv(index=False).encode())
    return result


def main(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    with writing(options.out):
        calibrate(options)
    return 0


if __name__ == "__main__":
    command(main, Options, __doc__, resumes=True)
