"""Choose the learner's settings: train every candidate, print which gates its agents pass, and name the best.

With --pairs, also how a control and a treated agent drive together, by every rule of `arms.PAIRS`.

    python experiments/choose.py results/choice-3                        # all candidates: about an hour and a half each
    python experiments/choose.py results/choice-3 --candidates tuned     # one of them; later ones join the folder
    python experiments/choose.py results/choice-3 --table                # what is there, nothing is computed
    python experiments/choose.py results/choice-3 --candidates tuned --pairs     # two agents together: ten minutes more

Each candidate is twelve cells of `sweep.py --preset choice --settings ...`: two settings, both arms, three training
seeds that no report uses. The rule was written before anything was trained: the most passed gates, then the higher
return of both arms. Differences between the arms are not looked at.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import shlex
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated

import pandas as pd
import tyro

from experiments.analysis.gates import FAILURES, GATES, gates
from experiments.analysis.pairs import units
from experiments.analysis.scores import in_order, with_outcomes
from experiments.study.compute.cells import compute
from experiments.study.design.arms import ARMS, PAIRS
from experiments.study.design.fingerprint import check_dynamics
from experiments.study.design.grid import Cell
from experiments.study.design.options import Asked, argument
from experiments.study.design.presets import cells_of
from experiments.study.design.sheet import sheet
from experiments.study.results.store import Results, Store, load
from experiments.support.arguments import command
from experiments.support.errors import UserError, unknown, writing

PLACES = {"two-way": (1,), "roundabout": (3,)}  # 5+2 and 15: where overtaking has to be learned, and entering
OWN = {"control": "regular", "treatment": "risky"}  # the traffic that an arm is trained in
# What differs from the profile "tuned", as `--settings` takes it.
CANDIDATES: dict[str, tuple[str, ...]] = {
    "tuned": (),
    "goals-free": ("clip_goals=false",),
    "half-rate": ("learning_rate=2.5e-4",),
    "fast-target": ("tau=0.005",),
    "short-sighted": ("gamma=0.9",),
}


@dataclass(frozen=True)
class Options:
    """Choose the learner's settings: train every candidate, print which gates its agents pass, and name the best."""

    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Directory for the cells of all candidates."""
    candidates: Annotated[tuple[str, ...], argument("NAME ...", "all")] = ()
    """tuned (the profile as it is), goals-free, half-rate, fast-target, short-sighted."""
    updates: Annotated[int | None, argument("N", "the study's")] = None
    """Training budget of an agent in updates."""
    episodes: Annotated[int | None, argument("N")] = None
    """Test episodes in each of the two traffics."""
    workers: Annotated[int | None, argument("N", "the number of cores")] = None
    """Cells that are computed at a time."""
    pairs: bool = False
    """Also test the agents of a seed together, by the rules that a plan can register."""
    table: bool = False
    """Print the table of what is there, and compute nothing."""


def cells(
    candidate: str, updates: int | None = None, episodes: int | None = None, pairs: bool = False
) -> list[Cell]:
    """The cells of a candidate; baselines are those of all. Raises UserError for one that there is not."""
    if candidate not in CANDIDATES:
        raise unknown("candidate", candidate, CANDIDATES)
    asked = [
        Asked(
            preset="choice",
            tasks=(task,),
            levels=levels,
            settings=CANDIDATES[candidate],
            updates=updates,
            episodes=episodes,
            pairs=pairs,
        )
        for task, levels in PLACES.items()
    ]
    return [cell for one in asked for cell in cells_of(one)]


def agents(results: Results, names: dict[str, list[str]]) -> pd.DataFrame:
    """A row an agent.

    Args:
        names: of the cells of each candidate.

    Returns:
        candidate, task, level_name, arm, seed; gates (how many it passes) and failed; return, crashed and speed in the
        test in its own traffic; share (the return as a share of its range on the task); cpu [s] of its training.
    """
    judged = gates(results.cells, results.gate_episodes).set_index("cell")
    own = results.episodes[results.episodes["traffic"] == results.episodes["arm"].map(OWN)]
    driven = own.groupby("cell")[["return", "crashed", "mean_speed"]].mean()
    rows = judged[["task", "level_name", "arm", "seed", "failed"]].join(driven)
    rows["gates"] = judged[list(GATES)].apply(lambda row: sum(passed is True for passed in row), axis=1)
    rows["share"] = rows["return"] / rows["task"].map(lambda task: sheet(task).return_range)
    rows["cpu"] = [results.cells[name]["timing"]["train_cpu_seconds"] for name in rows.index]
    parts = [rows.loc[rows.index.isin(own_cells)].assign(candidate=name) for name, own_cells in names.items()]
    return pd.concat(parts).rename(columns={"mean_speed": "speed"}).reset_index(drop=True)


def summary(found: pd.DataFrame) -> pd.DataFrame:
    """Means over the seeds of each candidate, setting and arm; gates are added up, and what failed is named."""
    by = found.groupby(["candidate", "task", "level_name", "arm"], sort=False)
    table = by.agg(agents=("seed", "size"), gates=("gates", "sum"), cpu=("cpu", "mean"))
    table = table.join(by[["return", "crashed", "speed"]].mean())
    table["failed"] = by["failed"].agg(
        lambda column: ", ".join(FAILURES[gate] for words in column for gate in words.split())
    )
    return table.reset_index()


def together(results: Results, names: Collection[str]) -> pd.DataFrame:
    """How the agents of a candidate drive alone and together, the training seeds that have all of it alike.

    Args:
        names: of the candidate's cells.

    Returns:
        A row a setting, traffic and who drives: crashes and their differences to one agent of either arm [points],
        speed [m/s] and return.
    """
    drives = with_outcomes(results)
    rows = units(drives[drives["cell"].isin(names)])
    place = ["task", "level_name", "traffic"]
    table = (
        rows.groupby([*place, "arm"], sort=False)[["crashed", "mean_speed", "return"]].mean().reset_index()
    )
    table["crashed"] *= 100
    for arm in ARMS:
        alone = table.loc[table["arm"] == arm, [*place, "crashed"]].rename(
            columns={"crashed": f"minus {arm}"}
        )
        table = table.merge(alone, on=place)
        table[f"minus {arm}"] = table["crashed"] - table[f"minus {arm}"]
    order = {name: number for number, name in enumerate((*ARMS, *PAIRS))}
    table["order"] = table["arm"].map(order)
    return in_order(table, *place, "order").drop(columns="order")


def rank(found: pd.DataFrame) -> pd.DataFrame:
    """The candidates, the best first: by the gates that their agents pass, then by the return of both arms.

    The return is the mean of both settings and arms, each as a share of the task's range. Raises UserError where
    candidates have not the same agents.
    """
    places = {
        name: sorted(zip(own["task"], own["arm"], own["seed"], strict=True))
        for name, own in found.groupby("candidate")
    }
    if len({str(agents) for agents in places.values()}) > 1:
        counts = ", ".join(f"{name} {len(agents)}" for name, agents in places.items())
        raise UserError(f"the candidates have not the same agents ({counts}): compute the others first")
    table = found.groupby("candidate").agg(
        gates=("gates", "sum"), share=("share", "mean"), cpu=("cpu", "sum")
    )
    return table.sort_values(["gates", "share"], ascending=False, kind="stable").reset_index()


def choose(options: Options, arguments: list[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    chosen = options.candidates or tuple(CANDIDATES)
    asked = {
        name: cells(name, options.updates, options.episodes, options.pairs) for name in dict.fromkeys(chosen)
    }
    if not options.table:
        every = list({cell.name: cell for own in asked.values() for cell in own}.values())
        check_dynamics({(cell.backend, cell.task) for cell in every})
        with writing(options.out):
            command = shlex.join(["python", "experiments/choose.py", *arguments])
            Store(options.out).write_sweep(command, every)
            for name, reason in compute(every, options.out, workers=options.workers).items():
                print(f"{name} failed: {reason}", file=sys.stderr)
    results, names = load(options.out), {name: [cell.name for cell in own] for name, own in asked.items()}
    found = agents(results, names)
    print(summary(found).to_string(index=False, float_format="{:.3f}".format))
    for name, own in names.items() if options.pairs else ():
        print(f"{name}: agents of a seed, alone and together")
        print(together(results, own).to_string(index=False, float_format="{:.1f}".format))
    ranking = rank(found)
    print(ranking.to_string(index=False, float_format="{:.3f}".format))
    print(
        f"chosen: {ranking['candidate'].iloc[0]} (of {len(GATES)} gates an agent; most passed, then the return)"
    )
    return 0


if __name__ == "__main__":
    command(lambda options: choose(options, sys.argv[1:]), Options, __doc__, resumes=True)
