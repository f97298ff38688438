"""Train and test one agent, and draw how it learned; policies that do not learn are tested in the same scenarios.

    python experiments/train.py --task u-turn --risk 1 --out results/mine
    python experiments/watch.py results/mine     # films it
    python experiments/test.py results/mine      # crash rate, return and speed at risk 0 and 1

Further agents in the same directory (another --risk, --seed, --network) are compared by test.py and report.py.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import shlex
from dataclasses import dataclass
from typing import Annotated

import tyro

from agents.files import atomic
from experiments.study.compute.cells import compute
from experiments.study.design.arms import EVERY_ARM
from experiments.study.design.experiment import Experiment
from experiments.study.design.fingerprint import check_dynamics, check_learners
from experiments.study.design.grid import Cell
from experiments.study.design.presets import cells_of
from experiments.study.results.store import Store
from experiments.study.results.working import LOG
from experiments.support.errors import UserError, run_command, unknown, writing
from sumo_env.tasks import TASKS

# The traffic of the training, and the arm of the experiment that it is.
ARMS = {
    arm.traffic.name if arm.traffic.drawn else f"{arm.traffic.dose:g}": arm.name
    for arm in EVERY_ARM.values()
    if not arm.rules
}
SMOOTH = 50  # training episodes over which the picture averages


@dataclass(frozen=True)
class Options:
    """Train and test one agent, and draw how it learned."""

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Directory for the agent; it may hold others already."""
    task: Annotated[str, tyro.conf.arg(help=f"One of {', '.join(TASKS)}.")] = "u-turn"
    level: int = 1
    """Traffic level; 1 is the lightest."""
    risk: str = "1"
    """Dose of risk in training: 0, 0.25, 0.5, 0.75, 1, or mixed (0 or 1 in each episode)."""
    seed: int = 0
    """Number of the training."""
    updates: int | None = None
    """Training budget in updates; by default that of the preset quick, a minute or two."""
    network: str | None = None
    """attention, dueling, or FILE:CLASS for a class of your own."""
    backend: str = "sumo"
    """Simulator: sumo, replica or highway-env."""


def agent_and_others(options: Options) -> tuple[Cell, list[Cell]]:
    """The agent's cell, and those of the policies that it is compared with.

    Raises:
        UserError: something in the options does not exist or makes no sense.
    """
    if options.risk not in ARMS:
        raise unknown("risk", options.risk, ARMS)
    cells = cells_of(
        Experiment(
            backend=options.backend,
            tasks=(options.task,),
            levels=(options.level,),
            seeds=1,
            first_seed=options.seed,
            arms=(ARMS[options.risk],),
            updates=options.updates,
            network=options.network,
        )
    )
    agent, *others = (cell for cell in cells if cell.kind in ("agent", "baseline"))
    return agent, others


def draw(directory: Path, cell: Cell) -> Path:
    """Draw the return and the crashes of a stored agent's training episodes; returns the file."""
    import matplotlib

    matplotlib.use("agg")
    episodes = Store(directory).training(cell.name).set_index("step")
    smooth = episodes[["return", "crashed"]].astype(float).rolling(SMOOTH, min_periods=1).mean()
    title = f"{cell.slug}: training episodes with exploration, mean of {SMOOTH}"
    axes = smooth.plot(subplots=True, figsize=(8, 5), grid=True, xlabel="environment steps", title=title)
    file = directory / f"{cell.name}.png"  # another training of this slug has another name
    with atomic(file) as opened:
        axes[0].figure.savefig(opened, format="png", dpi=110)
    return file


def train(options: Options, arguments: list[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    agent, others = agent_and_others(options)
    check_dynamics([(agent.backend, agent.task)])
    check_learners([(agent.policy, agent.profile)])
    with writing(options.out):
        command = shlex.join(["python", "experiments/train.py", *arguments])
        Store(options.out).write_sweep(command, [agent, *others])
        for name, reason in compute([agent, *others], options.out).items():
            raise UserError(f"{name} failed: {reason}; see {Store(options.out).work / name / LOG}")
        picture = draw(options.out, agent)
    print(f"{agent.slug} is trained and tested; its learning curve: {picture}")
    shown = [shlex.join(["python", f"experiments/{name}.py", str(options.out)]) for name in ("test", "watch")]
    print("next:", "; ".join(shown))
    return 0


if __name__ == "__main__":
    run_command(
        lambda: train(
            tyro.cli(Options, description=__doc__, config=(tyro.conf.FlagCreatePairsOff,)), sys.argv[1:]
        ),
        resumes=True,
    )
