"""Train and test one agent, and watch it learn; policies that do not learn are tested in the same scenarios.

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
from experiments.study.cell import TEST_EPISODE, CellTask
from experiments.study.experiment import Experiment
from experiments.study.fingerprint import check_dynamics
from experiments.study.grid import Cell
from experiments.study.presets import cells_of
from experiments.study.run import compute_here
from experiments.study.store import TRAINING, Store
from experiments.support.errors import UserError, run_command, unknown, writing

# The traffic of the training, and the arm of the experiment that it is.
ARMS = {"0": "control", "0.25": "dose25", "0.5": "dose50", "0.75": "dose75", "1": "treatment"}
ARMS |= {"mixed": "mixed", "drawn": "drawn"}
LINES = 20  # of a whole training in the terminal
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


class Watched(gym.Wrapper[Any, Any, Any, Any]):
    """Appends return and crash of every episode to a list."""

    def __init__(self, env: gym.Env[Any, Any], episodes: list[tuple[float, bool]]) -> None:
        super().__init__(env)
        self._episodes, self._total = episodes, 0.0

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Drive one step."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._total += float(reward)
        if terminated or truncated:
            self._episodes.append((self._total, bool(info["crashed"])))
            self._total = 0.0
        return observation, reward, terminated, truncated, info


def draw(directory: Path, cell: Cell) -> Path:
    """Draw the return and the crashes of a stored agent's training episodes; returns the file."""
    import matplotlib

    matplotlib.use("agg")
    episodes = Store(directory).tables(cell.name)[TRAINING].set_index("step")
    smooth = episodes[["return", "crashed"]].astype(float).rolling(SMOOTH, min_periods=1).mean()
    title = f"{cell.slug}: training episodes with exploration, mean of {SMOOTH}"
    axes = smooth.plot(subplots=True, figsize=(8, 5), grid=True, xlabel="environment steps", title=title)
    file = directory / f"{cell.slug}.png"
    axes[0].figure.savefig(file, dpi=110)
    return file


def train(options: Options, arguments: list[str]) -> int:
    """Do what the options ask for; returns the exit status.

    Raises:
        UserError: something has to be put right first, or the directory cannot be written.
    """
    agent, others = agent_and_others(options)
    check_dynamics([(agent.backend, agent.task)])
    episodes: list[tuple[float, bool]] = []  # since the last line
    training, last = agent.updates / (agent.updates + TEST_EPISODE * agent.work), 0  # share of the work

    def watched(backend: str, task: str, config: dict[str, Any]) -> gym.Env[Any, Any]:
        return Watched(make_env(backend, task, config), episodes)

    def beat(done: float) -> None:
        nonlocal last
        line = min(int(LINES * done / training + 1e-9), LINES + 1)
        if line > last and line > LINES:
            print("testing it in regular and in risky traffic", flush=True)
        elif line > last and episodes:
            returns, crashes = zip(*episodes, strict=True)
            numbers = f"return {fmean(returns):6.2f}  crashes {fmean(crashes):4.0%}"
            print(f"{line / LINES:4.0%}  {len(returns):4} episodes  {numbers}", flush=True)
            episodes.clear()
        last = max(last, line)

    with writing(options.out):
        command = shlex.join(["python", "experiments/train.py", *arguments])
        Store(options.out).write_sweep(command, [agent, *others])
        print(f"training {agent.slug}: {agent.updates} updates (stop and go on at any time)")
        compute_here(CellTask(agent, options.out, watched), beat)
        picture = draw(options.out, agent)
        print("testing policies that do not learn beside it", flush=True)
        for other in others:
            compute_here(CellTask(other, options.out, make_env))
    print(f"{agent.slug} is trained and tested; its learning curve: {picture}")
    print(f"next: python experiments/test.py {options.out}; python experiments/watch.py {options.out}")
    return 0


if __name__ == "__main__":
    run_command(
        lambda: train(
            tyro.cli(Options, description=__doc__, config=(tyro.conf.FlagCreatePairsOff,)), sys.argv[1:]
        )
    )
