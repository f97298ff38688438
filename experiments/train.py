"""Train and test one agent, and watch it learn.

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

import shlex
from dataclasses import dataclass
from statistics import fmean
from typing import Annotated, Any

import gymnasium as gym
import tyro

from experiments.backends import make_env
from experiments.study.cell import CellTask
from experiments.study.experiment import Experiment
from experiments.study.fingerprint import check_dynamics
from experiments.study.grid import Cell
from experiments.study.presets import cells_of
from experiments.study.run import compute_here
from experiments.study.store import TRAINING, Store
from experiments.support.errors import UserError, disk_error, run_command, unknown

# The traffic of the training, and the arm of the experiment that it is.
ARMS = {"0": "control", "0.25": "dose25", "0.5": "dose50", "0.75": "dose75", "1": "treatment"}
ARMS |= {"mixed": "mixed", "drawn": "drawn"}
LINES = 20  # of a whole training in the terminal
BLOCKS = "▁▂▃▄▅▆▇█"
SMOOTH = 50  # training episodes over which the picture averages


@dataclass(frozen=True)
class Options:
    """Train and test one agent, and watch it learn."""

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Directory for the agent; it may hold others already."""
    task: str = "u-turn"
    """highway, two-way, roundabout, intersection or u-turn."""
    level: int = 1
    """Traffic level; 1 is the lightest."""
    risk: str = "1"
    """Dose of risk in training: 0, 0.25, 0.5, 0.75, 1, mixed (0 or 1 in each episode) or drawn (any dose)."""
    seed: int = 0
    """Number of the training."""
    updates: int | None = None
    """Training budget in updates; by default that of the preset quick, a few minutes."""
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
    if options.seed < 0:
        raise UserError(f"--seed takes 0 or more, not {options.seed}")
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


class Live:
    """Prints how an agent learns: a line for each twentieth of the work, with the episodes since the last one."""

    def __init__(self, cell: Cell) -> None:
        self._training = cell.updates / (
            cell.updates + 10.0 * cell.work
        )  # share of the work that is training
        self._episodes: list[tuple[float, bool]] = []
        self._returns: list[float] = []
        self._next, self._tests = 1, False
        print(f"training {cell.slug}: {cell.updates} updates (stop and go on at any time)")

    def note(self, total: float, crashed: bool) -> None:
        """A training episode has ended."""
        self._episodes.append((total, crashed))

    def beat(self, done: float) -> None:
        """So much of the work is done, from 0 to 1; training comes first."""
        share = done / self._training
        if share >= self._next / LINES and self._next <= LINES and self._episodes:
            self._print(min(share, 1.0))
            self._next = int(share * LINES) + 1
        if share > 1.0 and not self._tests:
            self._tests = True
            print("testing it in regular and in risky traffic", flush=True)

    def _print(self, share: float) -> None:
        returns, crashes = zip(*self._episodes, strict=True)
        self._returns.append(fmean(returns))
        low, high = min(self._returns), max(self._returns)
        bars = "".join(BLOCKS[round(7 * (r - low) / ((high - low) or 1.0))] for r in self._returns)
        count = f"{len(returns)} episodes"
        print(
            f"{share:4.0%}  {count:>14}  return {fmean(returns):6.2f}  crashes {fmean(crashes):4.0%}  {bars}",
            flush=True,
        )
        self._episodes = []


class Watched(gym.Wrapper[Any, Any, Any, Any]):
    """Tells a `Live` of every episode."""

    def __init__(self, env: gym.Env[Any, Any], live: Live) -> None:
        super().__init__(env)
        self._live, self._total = live, 0.0

    def reset(self, **options: Any) -> tuple[Any, dict[str, Any]]:
        """Begin an episode."""
        self._total = 0.0
        return self.env.reset(**options)

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._total += float(reward)
        if terminated or truncated:
            self._live.note(self._total, bool(info["crashed"]))
        return observation, reward, terminated, truncated, info


def draw(directory: Path, cell: Cell) -> Path:
    """Draw the return and the crashes of a stored agent's training episodes; returns the file."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt

    episodes = Store(directory).tables(cell.name)[TRAINING]
    smooth = episodes[["return", "crashed"]].astype(float).rolling(SMOOTH, min_periods=1).mean()
    figure, panels = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    for panel, column, label in zip(
        panels, smooth, ("return", "share of episodes with a crash"), strict=True
    ):
        panel.plot(episodes["step"], smooth[column], color="#0072b2", lw=1.2)
        panel.set(xlabel="environment steps", ylabel=label)
        panel.grid(alpha=0.3)
    figure.suptitle(f"{cell.slug}: training episodes with exploration, mean of {SMOOTH}", fontsize=10)
    file = directory / f"{cell.slug}.png"
    figure.savefig(file, dpi=110)
    plt.close(figure)
    return file


def train(options: Options, arguments: list[str]) -> int:
    """Do what the options ask for; returns the exit status.

    Raises:
        UserError: something has to be put right first, or the directory cannot be written.
    """
    agent, others = agent_and_others(options)
    check_dynamics([(agent.backend, agent.task)])
    live = Live(agent)

    def watched(backend: str, task: str, config: dict[str, Any]) -> gym.Env[Any, Any]:
        return Watched(make_env(backend, task, config), live)

    try:
        Store(options.out).write_sweep(
            shlex.join(["python", "experiments/train.py", *arguments]), [agent, *others]
        )
        compute_here(CellTask(agent, options.out, watched), live.beat)
        picture = draw(options.out, agent)
    except OSError as error:
        raise disk_error(error, options.out) from None
    print(f"{agent.slug} is trained and tested; its learning curve: {picture}")
    print(f"next: python experiments/test.py {options.out}; python experiments/watch.py {options.out}")
    return 0


if __name__ == "__main__":
    run_command(
        lambda: train(
            tyro.cli(Options, description=__doc__, config=(tyro.conf.FlagCreatePairsOff,)), sys.argv[1:]
        )
    )
