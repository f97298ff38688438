"""Is it the same task? Agents trained in one simulator, tested in the other.

    python experiments/transfer.py --out results/transfer            # two hours of processor time
    python experiments/transfer.py --out /tmp/transfer --tasks u-turn --seeds 1 --updates 500 --episodes 10

Trains control agents in both simulators (lightest traffic, budget of the preset `quick`), tests every agent in both on
the same regular and risky scenarios, beside drivers that do not learn. Writes transfer.csv (a row for each policy and
simulator it was tested in) and transfer.png. The same command run again goes on where it was stopped.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import multiprocessing
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.table import Table

from experiments.study import grid
from experiments.study.engine import Engine
from experiments.study.estimate import rates
from experiments.study.grid import BACKENDS, Cell
from experiments.study.presets import get_preset
from experiments.study.progress import display
from experiments.study.store import EPISODES, WEIGHTS, read_episodes
from experiments.support.errors import UserError, disk_error, run_command
from experiments.support.files import write_file
from experiments.validation.stage import open_env

if TYPE_CHECKING:
    import pandas as pd

COMPARED = ("idle", "random", "idm")  # drivers that an agent has to be held against
MEASURES = ("return", "crashed", "arrived", "length", "mean_speed")
COLOURS = {"sumo": "#0072b2", "highway-env": "#d55e00"}


@dataclass(frozen=True)
class Options:
    """Agents trained in one simulator, tested in the other."""

    out: Path
    """Directory for the agents, transfer.csv and transfer.png."""
    tasks: Annotated[tuple[str, ...], tyro.conf.arg(metavar="TASK ...")] = ("highway", "intersection")
    """Some of highway, two-way, roundabout, intersection, u-turn."""
    seeds: int = 3
    """Training seeds in each simulator."""
    episodes: int = 50
    """Test episodes in each of the two traffics."""
    updates: int | None = None
    """Training budget of an agent (default: that of the preset quick)."""
    workers: int = 2
    """Number of processes."""


def cells_of(options: Options) -> list[Cell]:
    """Agents of both simulators, and the drivers that do not learn."""
    preset = get_preset("quick")
    tasks = grid.choose_tasks(options.tasks)
    profiles = preset.profiles(updates=options.updates)
    cells = []
    for backend in BACKENDS:
        cells += grid.build(
            backend, grid.choose_levels(tasks, (1,)), options.seeds, options.episodes, profiles, preset.name
        )
    return [cell for cell in cells if cell.arm == "control" or cell.policy in COMPARED]


def test_abroad(work: tuple[Path, Cell]) -> None:
    """Test an agent in the simulator that it was not trained in; its episodes are stored beside its cell's."""
    from experiments.study.evaluate import evaluate
    from experiments.study.policies import load_agent

    directory, cell = work
    backend = other(cell.backend)
    env = open_env(backend, cell.task, grid.env_config(backend, cell.task, cell.level))
    seen, policy = load_agent(cell.key(), cell.source, directory / "cells" / cell.name / WEIGHTS, env)
    table = evaluate(seen, policy, cell.task, cell.level, cell.episodes)
    env.close()
    write_file(abroad(directory, cell), table.to_parquet(index=False))


def other(backend: str) -> str:
    """The other simulator."""
    return BACKENDS[1 - BACKENDS.index(backend)]


def abroad(directory: Path, cell: Cell) -> Path:
    """Where the episodes of an agent in the other simulator are stored."""
    return directory / "abroad" / f"{cell.name}.parquet"


def summarise(directory: Path, cells: Sequence[Cell]) -> pd.DataFrame:
    """A row for each policy, simulator that it was tested in, and traffic: means and standard errors.

    The unit is the training seed for agents, the test episode for the others.
    """
    import pandas as pd

    parts = []
    for cell in cells:
        home = directory / "cells" / cell.name
        files = {cell.backend: home / EPISODES}
        if cell.arm:
            files[other(cell.backend)] = abroad(directory, cell)
        for tested, file in files.items():
            table = read_episodes(home) if file.parent == home else pd.read_parquet(file)
            trained = cell.backend if cell.arm else ""
            labels = {"task": cell.task, "tested": tested, "policy": cell.policy, "trained": trained}
            parts.append(table[["traffic", "scenario", *MEASURES]].assign(seed=cell.seed or 0, **labels))
    episodes = pd.concat(parts, ignore_index=True)
    rows = []
    for key, group in episodes.groupby(["task", "tested", "traffic", "policy", "trained"], sort=False):
        units = group.groupby("seed" if key[-1] else "scenario")[list(MEASURES)].mean().astype(float)
        rows.append(
            {
                **dict(zip(("task", "tested", "traffic", "policy", "trained"), key, strict=True)),
                "units": len(units),
                **{name: units[name].mean() for name in MEASURES},
                **{f"{name}_se": units[name].sem() for name in ("return", "crashed")},
            }
        )
    return pd.DataFrame(rows)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Return and crash rate in regular traffic: where tested across, where trained as colour."""
    from matplotlib import pyplot as plt

    table = table[table["traffic"] == "regular"]
    tasks = list(dict.fromkeys(table["task"]))
    figure, axes = plt.subplots(2, len(tasks), figsize=(3.6 * len(tasks), 5.0), squeeze=False, sharex=True)
    for column, task in enumerate(tasks):
        rows = table[table["task"] == task]
        for axis, measure, label in (
            (axes[0, column], "return", "return"),
            (axes[1, column], "crashed", "crash rate"),
        ):
            for number, (trained, colour) in enumerate(COLOURS.items()):
                own = rows[rows["trained"] == trained].set_index("tested").reindex(BACKENDS)
                axis.errorbar(
                    [place + 0.06 * (2 * number - 1) for place in range(2)], own[measure], yerr=own[f"{measure}_se"],
                    fmt="o", color=colour, capsize=3, label=f"trained in {trained}",
                )  # fmt: skip
            for name, mark in zip(COMPARED, ("_", "x", "+"), strict=True):
                own = rows[rows["policy"] == name].set_index("tested").reindex(BACKENDS)
                axis.plot(range(2), own[measure], mark, color="#777777", label=name)
            axis.set_ylabel(label)
            axis.set_xlim(-0.5, 1.5)
            axis.set_xticks(range(2), [f"tested in\n{name}" for name in BACKENDS])
            axis.spines[["top", "right"]].set_visible(False)
        axes[0, column].set_title(task)
        axes[1, column].set_ylim(bottom=0)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=len(labels), fontsize=8, frameon=False)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def show(table: pd.DataFrame, console: Console) -> None:
    """The table on the terminal."""
    shown = Table("task", "traffic", "tested in", "policy", "return", "crash rate")
    for row in table.sort_values(["task", "traffic", "tested", "policy", "trained"]).to_dict("records"):
        name = f"trained in {row['trained']}" if row["trained"] else row["policy"]
        shown.add_row(
            row["task"], row["traffic"], row["tested"], name, f"{row['return']:.2f} ± {row['return_se']:.2f}",
            f"{row['crashed']:.2f} ± {row['crashed_se']:.2f}",
        )  # fmt: skip
    console.print(shown)


def transfer(options: Options) -> pd.DataFrame:
    """Train and test whatever is not there yet, and write the results.

    Raises:
        UserError: a cell failed, or something has to be put right first.
    """
    directory = options.out
    cells = cells_of(options)
    engine = Engine(directory, cells, options.workers, open_env, rates(directory).seconds)
    engine.run(display())
    if engine.failed:
        raise UserError("; ".join(f"{name}: {reason}" for name, reason in engine.failed.items()))
    (directory / "abroad").mkdir(exist_ok=True)
    left = [(directory, cell) for cell in cells if cell.arm and not abroad(directory, cell).exists()]
    # a process for each: highway-env's tasks change class attributes of each other
    with multiprocessing.get_context("spawn").Pool(options.workers, maxtasksperchild=1) as pool:
        for _ in pool.imap_unordered(test_abroad, left, chunksize=1):
            pass
    table = summarise(directory, cells)
    table.round(4).to_csv(directory / "transfer.csv", index=False)
    draw(table, directory / "transfer.png")
    return table


def main() -> int:
    """The command line."""
    options = tyro.cli(Options, description=__doc__)
    for name in ("seeds", "episodes", "workers"):
        if getattr(options, name) < 1:
            raise UserError(f"--{name} must be at least 1, not {getattr(options, name)}")
    try:
        options.out.mkdir(parents=True, exist_ok=True)
        table = transfer(options)
    except OSError as error:
        raise disk_error(error, options.out) from None
    show(table, Console())
    print(f"picture: {options.out / 'transfer.png'}")
    return 0


if __name__ == "__main__":
    run_command(main)
