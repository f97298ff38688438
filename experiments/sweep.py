"""Run the experiment: train and test the agents of both arms and the baselines, then write the report.

    python experiments/sweep.py
    python experiments/sweep.py --preset smoke --out results/smoke
    python experiments/sweep.py --preset paper --dry-run
    python experiments/sweep.py --placebo                                  # control against control

The same command run again continues where it was stopped. Finished cells are never
computed twice. Several sweeps on one directory, also from several machines, share the work.

Exit status: 0 all done, 1 some cells failed (everything else is kept), 2 something has to be put right
first, 130 stopped with Ctrl-C.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import pandas as pd

from experiments import backends
from experiments.backends import MakeEnv
from experiments.study.compute.cells import CellTask, compute
from experiments.study.compute.executors import EXECUTORS, cores
from experiments.study.compute.progress import costs, duration
from experiments.study.compute.run import compute_here
from experiments.study.design.cell import Cell
from experiments.study.design.experiment import Experiment, shard
from experiments.study.design.fingerprint import check_dynamics, check_learners, dynamics, known_dynamics
from experiments.study.design.presets import asked_preset, cells_of, of_preset
from experiments.study.results.store import Store, find_cell
from experiments.study.results.working import LOG
from experiments.support.arguments import Flag, argument, as_typed, command
from experiments.support.errors import UserError, check_known, check_least, writing


@dataclass(frozen=True, kw_only=True)
class Options(Experiment):
    """Train and test the agents of both arms and the baselines, then write the report."""

    out: Annotated[Path | None, argument("DIR", "results/BACKEND-PRESET")] = None
    """Directory for the results."""
    executor: Annotated[str, argument("NAME")] = "local"
    """Where cells are computed: local (processes of this machine), ray or slurm (docs/clusters.md)."""
    workers: Annotated[int | None, argument("N", "the number of cores; on Slurm 100")] = None
    """Cells that are computed at a time."""
    shard: Annotated[str, argument("I/N")] = "1/1"
    """Compute only this part of the cells, for job arrays."""
    cell: Annotated[str | None, argument("NAME", "all")] = None
    """Compute this cell alone (the beginning of its name is enough) and in this process, to see why it fails."""
    dry_run: Flag = False
    """Print the cells and an estimate of the time, and compute nothing."""

    @property
    def directory(self) -> Path:
        """Where the results go."""
        return self.out or Path("results") / f"{self.backend}-{self.preset}"


def sweep(
    options: Options,
    arguments: Sequence[str] = (),
    make_env: MakeEnv = backends.make_env,
    check: Callable[[Iterable[tuple[str, str]]], None] = check_dynamics,
) -> int:
    """Do what the options ask for; returns the exit status.

    arguments: the command line, to say how to resume. make_env: of `backends`, or another that is importable in other
    processes. check: of the simulators of these backends and tasks, before anything is trained.
    """
    check_least(options, workers=1)
    check_known("executor", [options.executor], EXECUTORS)
    cells = cells_of(options, known_dynamics if options.dry_run else dynamics, make_env)
    mine = shard(cells, options.shard)
    if options.cell:
        name = find_cell(options.cell, [cell.name for cell in mine])
        mine = [cell for cell in mine if cell.name == name]
    if options.dry_run:
        describe(options, mine, options.workers or cores())
        return 0
    check(pair for cell in mine for pair in cell.simulated)
    there = set(Store(options.directory).finished())
    new = [cell for cell in mine if cell.name not in there]
    check_learners((cell.policy, cell.profile) for cell in new if cell.kind == "agent")
    refuse_early(new, options.executor)
    again = as_typed("sweep", arguments)
    with writing(options.directory):
        if options.cell:
            compute_here(CellTask(mine[0], options.directory, make_env))
            print(f"finished: {Store(options.directory).cells / mine[0].name}")
            return 0
        Store(options.directory).write_sweep(again, cells)
        failures = compute(mine, options.directory, make_env, options.executor, options.workers)
        try:
            if len(failures) < len(mine) == len(cells):  # a shard alone is no study to report
                report(options.directory, strict=not failures)
        finally:
            status = say_failures(failures, options.directory, again)
    return status


def report(directory: Path, strict: bool) -> None:
    """Write the report; where it is not strict, what stands against one is only said."""
    from experiments.report import print_report

    print("writing the report", flush=True)
    try:
        print_report(directory)
    except UserError as error:
        if strict:
            raise
        print(f"no report: {error}", file=sys.stderr)


def refuse_early(cells: Iterable[Cell], executor: str) -> None:
    """Raise UserError for what would fail later: a missing device, no Slurm."""
    if executor == "slurm" and shutil.which("srun") is None:
        raise UserError("--executor slurm is for machines that submit jobs to Slurm: there is no srun")
    for cell in cells:
        if cell.kind == "agent" and executor == "local" and (device := cell.profile.get("device")):
            import torch  # here: not every command needs the learner

            try:
                torch.empty(0, device=device)
            except (RuntimeError, AssertionError) as error:
                raise UserError(f"device {device}: {str(error).splitlines()[0]}") from None


def say_failures(failures: Mapping[str, str], directory: Path, again: str) -> int:
    """Say which cells failed, why, and what to do; returns the exit status."""
    for name, reason in failures.items():
        print(f"{name} failed: {reason}\n    log: {Store(directory).work / name / LOG}", file=sys.stderr)
        print(f"    to see it fail: {again} --cell {name}", file=sys.stderr)
    if failures:
        print(f"failed cells: {len(failures)}, all others are kept; to try again: {again}", file=sys.stderr)
    return 1 if failures else 0


def describe(options: Options, cells: Sequence[Cell], workers: int) -> None:
    """Print what would be computed and how long it would take."""
    there = set(Store(options.directory).finished())
    table = pd.DataFrame(
        {"task": [cell.task for cell in cells], "level": [cell.level_name for cell in cells]}
    )
    for kind in ("agent", "baseline", "test"):
        table[f"{kind}s"] = [cell.kind == kind for cell in cells]
    table["finished"] = [cell.name in there for cell in cells]
    table["core hours"] = [sum(costs(cell)) / 3600 for cell in cells] * ~table["finished"]
    table = table.groupby(["task", "level"], sort=False, as_index=False).sum()
    print(f"preset {options.preset}: {options.about}\nresults go to {options.directory}")
    print(table.to_string(index=False, float_format="{:.2f}".format))
    if new := list(dict.fromkeys(cell.task for cell in cells if not cell.dynamics)):
        print(
            f"{', '.join(new)}: not in fingerprints.json, so that names, and what is finished, are not known yet"
        )
    print(
        f"{table['agents'].sum()} agents and {table['baselines'].sum()} baselines; about "
        f"{duration(3600 * table['core hours'].sum() / workers)} left with {workers} processes on a common server"
    )


if __name__ == "__main__":
    command(
        lambda options: sweep(options, sys.argv[1:]),
        Options,
        __doc__,
        resumes=True,
        default=lambda words: of_preset(Options, asked_preset(words)),
    )
