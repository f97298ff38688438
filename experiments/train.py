"""Train and test one agent, and draw how it learned; policies that do not learn are tested in the same scenarios.

    python experiments/train.py --out results/mine                             # u-turn, among risky drivers
    python experiments/train.py --tasks highway --arms control --out results/mine
    python experiments/watch.py results/mine        # films it
    python experiments/evaluate.py results/mine     # crash rate, return and speed in the frozen test

An agent is a cell of a sweep, so that all options of sweep.py choose it; by default one agent of the preset quick.
Further agents in the same directory are compared by report.py.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from agents.files import atomic
from experiments.study.compute.cells import compute
from experiments.study.design.cell import Cell
from experiments.study.design.experiment import Experiment
from experiments.study.design.fingerprint import check_dynamics, check_learners
from experiments.study.design.levels import is_usual
from experiments.study.design.presets import asked_preset, cells_of, of_preset
from experiments.study.results.store import Store
from experiments.study.results.working import LOG
from experiments.support.arguments import as_typed, command
from experiments.support.errors import UserError, writing

SMOOTH = 50  # training episodes over which the picture averages


@dataclass(frozen=True, kw_only=True)
class Options(Experiment):
    """Train and test one agent, and draw how it learned."""

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Directory for the agent; it may hold others already."""


def default(words: Sequence[str] = (), out: Path = tyro.MISSING) -> Options:
    """The options of a command line that says no more than its preset: one agent."""
    one: dict[str, Any] = {"tasks": ("u-turn",), "levels": (1,), "seeds": 1, "arms": ("treatment",)}
    return of_preset(Options, asked_preset(words), **one, out=out)


def draw(directory: Path, cell: Cell) -> Path:
    """Draw the return and the crashes of a stored agent's training episodes; returns the file."""
    import matplotlib

    matplotlib.use("agg")
    episodes = Store(directory).training(cell.name).set_index("step")
    smooth = episodes[["return", "crashed"]].astype(float).rolling(SMOOTH, min_periods=1).mean()
    title = f"{cell.slug}: training episodes with exploration, mean of {SMOOTH}"
    form: dict[str, Any] = {"subplots": True, "figsize": (8, 5), "grid": True, "legend": False}
    axes = smooth.plot(xlabel="environment steps", title=title, **form)
    for panel, name in zip(axes, ("return", "episodes with a crash"), strict=True):
        panel.set_ylabel(name)
    file = directory / f"{cell.name}.png"  # another training of this slug has another name
    with atomic(file) as opened:
        axes[0].figure.savefig(opened, format="png", dpi=110)
    return file


def train(options: Options, arguments: list[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    asked = cells_of(options)
    agents = [cell for cell in asked if cell.kind == "agent"]
    check_dynamics(pair for cell in asked for pair in cell.simulated)
    check_learners((cell.policy, cell.profile) for cell in agents)
    with writing(options.out):
        Store(options.out).write_sweep(as_typed("train", arguments), asked)
        for name, reason in compute(asked, options.out).items():
            raise UserError(f"{name} failed: {reason}; see {Store(options.out).work / name / LOG}")
        for cell in agents:
            print(f"{cell.slug} is trained and tested; its learning curve: {draw(options.out, cell)}")
    print("next:", "; ".join(following(options.out, agents)))
    return 0


def following(directory: Path, agents: Sequence[Cell]) -> list[str]:
    """Commands that take these agents: the test is on SUMO, in each task's own configuration, and of our learners."""
    code = next((cell.source for cell in agents if cell.source), None)
    usual = all(is_usual("sumo", cell.task, cell.level, cell.env_config) for cell in agents)
    shown = [["evaluate"]] if usual and not code else []
    shown.append(["watch", "--code", code] if code else ["watch"])
    return [as_typed(name, [str(directory), *more]) for name, *more in shown]


if __name__ == "__main__":
    command(lambda options: train(options, sys.argv[1:]), Options, __doc__, resumes=True, default=default)
