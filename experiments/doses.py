"""What a dose of risky traffic does: how often egos crash at every dose, with and without events, in light traffic.

    python experiments/doses.py --out results/doses
    python experiments/doses.py --out results/doses --tasks u-turn --scenarios 10      # minutes

Drives on SUMO and, if it has the task, on the replica, and writes doses.csv. The same command run again continues where
it was stopped.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from dataclasses import dataclass, replace

import pandas as pd

from experiments.backends import has
from experiments.study.design.fingerprint import check_dynamics
from experiments.study.design.levels import StudyTasks, choose_tasks
from experiments.study.design.traffic import AT_A_DOSE
from experiments.support.arguments import command
from experiments.support.errors import writing
from experiments.support.files import write_file
from experiments.validation import episodes
from experiments.validation.checks import REFERENCE
from experiments.validation.episodes import Engine
from sumo_env.traffic.risk import RATES

EGOS = ("careful", "idm", "idle")
DOSES = tuple(AT_A_DOSE)
SUMO = Engine("sumo", "sumo", egos=EGOS)
NO_EVENTS = {"risk_rates": dict.fromkeys(RATES, 0.0)}
ENGINES = (
    SUMO,
    replace(SUMO, name="sumo, parameters alone", options=NO_EVENTS),
    Engine(REFERENCE, "replica", {"variant": "path"}, egos=EGOS),
)


@dataclass(frozen=True)
class Options:
    """Measure how often egos crash at every dose of risk."""

    out: Path
    """Directory for doses.csv."""
    tasks: StudyTasks = ()
    scenarios: int = 100
    """Scenarios of each dose; every ego drives each."""
    workers: int = 2
    """Number of processes."""


def doses(options: Options) -> pd.DataFrame:
    """Crash rate, time to crash [s], length [policy steps] and return, by engine, task, traffic and ego.

    Written to doses.csv as well.

    Raises:
        UserError: unknown task; a simulator has other dynamics than its name says; a part failed.
    """
    driven = [
        (task, engine)
        for task in choose_tasks(options.tasks)
        for engine in ENGINES
        if has(engine.backend, task)
    ]
    check_dynamics((engine.backend, task) for task, engine in driven)
    work = [
        part
        for task, engine in driven
        for part in episodes.plan([engine], {task: (1,)}, DOSES, range(options.scenarios))
    ]
    rows = episodes.run(work, options.out / "parts", options.workers)
    table = rows.groupby(["engine", "task", "traffic", "ego"], sort=False, as_index=False).agg(
        crash_rate=("crashed", "mean"),
        time_to_crash=("crash_time", "mean"),
        length=("length", "mean"),
        episode_return=("return", "mean"),
        episodes=("crashed", "size"),
    )
    write_file(options.out / "doses.csv", table.round(4).to_csv(index=False).encode())
    return table


def main(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    with writing(options.out):
        doses(options)
    return 0


if __name__ == "__main__":
    command(main, Options, __doc__, resumes=True)
