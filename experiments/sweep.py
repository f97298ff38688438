"""Run the experiment: train and test the agents of both arms and the baselines, then write the report.

    python experiments/sweep.py
    python experiments/sweep.py --preset smoke --out /tmp/smoke
    python experiments/sweep.py --preset paper --dry-run
    python experiments/sweep.py --placebo                                  # control against control
    python experiments/sweep.py --tasks highway --arms control penalty     # a positive control

The same command run again goes on where it was stopped, whatever stopped it; finished cells are never
computed twice. Several sweeps on one directory, also from several machines, share the work. DIR/sweep.log says what
happens (tail -f).

Exit status: 0 all done, 1 some cells failed (everything else is kept), 2 something has to be put right
first, 130 stopped with Ctrl-C.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import json
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from experiments.backends import make_env
from experiments.study import grid
from experiments.study.arms import ARMS
from experiments.study.cell import SILENCE, CellTask, MakeEnv
from experiments.study.estimate import START, Rates, duration, rates_of
from experiments.study.executors import EXECUTORS, cores, open_executor
from experiments.study.fingerprint import check_dynamics
from experiments.study.grid import Cell
from experiments.study.policies import foreign
from experiments.study.presets import get_preset
from experiments.study.progress import Progress
from experiments.study.run import LOG, compute_here, run
from experiments.study.store import Store, finished, weights_file
from experiments.support.errors import UserError, disk_error, run_command, unknown
from experiments.validation.status import before_training

PLACEBO_SEEDS = 4  # control agents at least, to be dealt into two arms
TASKS_PER_PROCESS = 25  # of highway-env 1: its tasks change class attributes of each other

# backend, tasks, directory of the results, processes, what to call with what is being done
Validate = Callable[[str, Sequence[str], Path, int, Callable[[str], None]], object]


def _argument(metavar: str, default: str = "the preset's") -> Any:
    """How an argument is shown in the help text."""
    return tyro.conf.arg(metavar=metavar, help_behavior_hint=f"(default: {default})")


Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]


@dataclass(frozen=True)
class Options:
    """Train and test the agents of both arms and the baselines, then write the report."""

    backend: Annotated[str, _argument("NAME", "sumo")] = "sumo"
    """Simulator: sumo, replica (highway-env's physics, compiled) or highway-env."""
    preset: Annotated[str, _argument("NAME", "quick")] = "quick"
    """Size of the experiment: smoke (a minute), quick (20 minutes on two cores), standard or paper (many hours)."""
    out: Annotated[Path | None, _argument("DIR", "results/BACKEND-PRESET")] = None
    """Directory for the results."""
    tasks: Annotated[tuple[str, ...], _argument("TASK ...", "all")] = ()
    """Some of highway, two-way, roundabout, intersection, u-turn."""
    levels: Annotated[tuple[str, ...], _argument("LEVEL ...")] = ()
    """Traffic levels by number; 1 is the lightest."""
    seeds: Annotated[int | None, _argument("N")] = None
    """Training seeds in each arm."""
    episodes: Annotated[int | None, _argument("N")] = None
    """Test episodes in each of the two traffics."""
    updates: Annotated[int | None, _argument("N")] = None
    """Training budget of an agent in updates, the same for all tasks."""
    arms: Annotated[tuple[str, ...], _argument("ARM ...", "control treatment")] = ()
    """Arms: control, treatment, dose25, dose50, dose75 (then tested at these too), dense, penalty, mixed, mixed-seen,
    drawn."""
    placebo: Flag = False
    """Train control agents alone, twice as many, and compare them with each other: no effect should be found."""
    test_on: Annotated[tuple[str, ...], _argument("NAME ...", "none")] = ()
    """Other simulators on which the trained agents are tested as well."""
    unseen: Flag = False
    """Test the trained agents in risky traffic that nobody was trained in as well: each kind of event alone, risky
    drivers without events, and SUMO's car-following models Krauss and EIDM."""
    early_tests: Flag = False
    """Also test every agent as it was after a third and two thirds of its budget."""
    frontier: Flag = False
    """Test the careful driver at five cautions: with the constant policies, the crashes of a speed without learning."""
    config: Annotated[tuple[str, ...], _argument("KEY=VALUE ...", "none")] = ()
    """Keys of the environments' configuration to set, for training and test (values as in JSON, or plain words)."""
    gamma: Annotated[float | None, _argument("X")] = None
    """Discount factor."""
    crash_reward: Annotated[float | None, _argument("X", "none")] = None
    """Added to the reward of a crash in training, in all arms (the two-way road's own has no term for crashes)."""
    network: Annotated[str | None, _argument("NAME")] = None
    """Network of the agents: attention, dueling, or FILE:CLASS for a class of your own."""
    policy: Annotated[tuple[str, ...], _argument("FILE:MAKE ...", "none")] = ()
    """Policies of your own to test as well: FILE:MAKE, or a model.zip of Stable-Baselines3."""
    device: Annotated[str | None, _argument("NAME", "cpu")] = None
    """Where agents learn: cpu or cuda."""
    executor: Annotated[str, _argument("NAME", "local")] = "local"
    """Where cells are computed: local (processes of this machine), ray or slurm (docs/clusters.md)."""
    workers: Annotated[int | None, _argument("N", "the number of cores; on Slurm 100")] = None
    """Cells that are computed at a time."""
    shard: Annotated[str, _argument("I/N", "1/1")] = "1/1"
    """Compute only this part of the cells, for job arrays."""
    cell: Annotated[str | None, _argument("NAME", "all")] = None
    """Compute this cell alone and in this process, to see why it fails."""
    hang_after: Annotated[float, _argument("SECONDS", "900")] = SILENCE
    """A cell that makes no progress for so long hangs, and is begun again."""
    dry_run: Flag = False
    """Print the cells and an estimate of the time, and compute nothing."""

    @property
    def directory(self) -> Path:
        """Where the results go."""
        return self.out or Path("results") / f"{self.backend}-{self.preset}"


def cells_of(options: Options) -> list[Cell]:
    """All cells that the options ask for.

    Raises:
        UserError: something in the options does not exist or makes no sense.
    """
    if options.placebo and options.arms:
        raise UserError("--placebo trains control agents alone: leave out --arms")
    for level in options.levels:
        if not level.isdecimal():
            raise UserError(f"--levels takes numbers, 1 is the lightest traffic, not {level!r}")
    preset = get_preset(options.preset)
    tasks = grid.choose_tasks(options.tasks or tuple(grid.TASKS))
    own = options.network if ":" in (options.network or "") else None
    label, fingerprint = foreign(own) if own else (options.network, None)
    profiles = preset.profiles(
        updates=options.updates,
        gamma=options.gamma,
        network=label,
        device=options.device,
        crash_reward=options.crash_reward,
    )
    if fingerprint:
        profiles = {task: {**profile, "network_sha256": fingerprint} for task, profile in profiles.items()}
    seeds = preset.seeds if options.seeds is None else options.seeds
    ask = grid.Ask(
        backend=options.backend,
        levels=grid.choose_levels(tasks, tuple(map(int, options.levels)) or preset.levels),
        seeds=max(2 * seeds, PLACEBO_SEEDS) if options.placebo else seeds,
        episodes=preset.episodes if options.episodes is None else options.episodes,
        profiles=profiles,
        preset=preset.name,
        gate_episodes=preset.gate_episodes,
        network=own,
        policies={label: (name, sha) for name in options.policy for label, sha in [foreign(name)]},
        arms=("control",) if options.placebo else options.arms or tuple(ARMS),
        test_on=options.test_on,
        unseen=options.unseen,
        frontier=options.frontier,
        first_seed=preset.first_seed,
        first_scenario=preset.first_scenario,
        changes=dict(map(_key_and_value, options.config)),
        early_tests=options.early_tests,
    )
    return grid.build(ask)


def _key_and_value(text: str) -> tuple[str, Any]:
    """Of "collision_reward=-2" or "risk_law=linear"."""
    key, equals, value = text.partition("=")
    if not (key and equals):
        raise UserError(f"--config takes KEY=VALUE, for example collision_reward=-2, not {text!r}")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


def sweep(
    options: Options,
    make_env: MakeEnv = make_env,
    arguments: Sequence[str] = (),
    validate: Validate | None = None,
) -> int:
    """Do what the options ask for; returns the exit status.

    Args:
        make_env: makes an environment from (backend, task, config); importable in another process.
        arguments: the command line, to say how to resume.
        validate: says how close the backend's tasks are to highway-env, before anything is trained.

    Raises:
        UserError: something has to be put right first.
    """
    if options.workers is not None and options.workers < 1:
        raise UserError(f"--workers must be at least 1, not {options.workers}")
    if not 1.0 <= options.hang_after <= 1e6:
        raise UserError(f"--hang-after takes 1 to 1000000 seconds, not {options.hang_after:g}")
    if options.executor not in EXECUTORS:
        raise unknown("executor", options.executor, EXECUTORS)
    # Processes of this machine, which validates whoever computes the cells.
    here = options.workers if options.workers and options.executor == "local" else cores()
    cells = cells_of(options)
    mine = grid.shard(cells, options.shard)
    rates = rates_of(options.directory)
    if options.dry_run:
        describe(options, mine, rates, here)
        return 0
    if validate is not None:
        check_dynamics(
            dict.fromkeys((name, cell.task) for cell in mine for name in (cell.backend, cell.runs_on))
        )
    tasks = {
        cell.name: CellTask(cell, options.directory, make_env, rates.seconds(cell), options.hang_after)
        for cell in mine
    }
    again = shlex.join(["python", "experiments/sweep.py", *arguments])
    try:
        if options.cell:
            return compute_one(options.cell, tasks)
        store = Store(options.directory)
        store.write_sweep(again, cells)
        if validate is not None:
            names = tuple(dict.fromkeys(cell.task for cell in cells))
            validate(options.backend, names, options.directory, here, lambda words: print(words, flush=True))
        failures = compute(options, store, tasks, rates, again)
    except OSError as error:
        raise disk_error(error, options.directory) from None
    return conclude(options, tasks, failures, again)


def compute(
    options: Options, store: Store, tasks: Mapping[str, CellTask], rates: Rates, again: str
) -> dict[str, str]:
    """Compute the cells that are not finished; returns the reason of each failure by the name of its cell."""
    there = {name for name, task in tasks.items() if task.done()}
    for name in tasks:
        store.forget(name, name in there)
    found = f"{len(tasks)} cells, {len(there)} of them finished before"
    print(f"{found}; results go to {store.directory}", flush=True)
    per_process = 1 if "highway-env" in (options.backend, *options.test_on) else TASKS_PER_PROCESS
    progress = Progress(store, [task.cell for task in tasks.values()], there, rates, f"{again} --cell")
    failures: dict[str, str] = {}
    try:
        for kinds in (("agent", "baseline"), ("test",)):  # agents are tested elsewhere once all are trained
            batch = [task for name, task in tasks.items() if name not in there and task.cell.kind in kinds]
            if kinds == ("test",):
                batch = [task for task in batch if weights_file(store.directory, task.cell.parent.name)]
            if batch:
                executor, progress.workers = open_executor(
                    options.executor, options.workers, store.directory, per_process
                )
                failures |= run(batch, executor, progress.workers, progress)
    finally:
        progress.close()
    return failures


def compute_one(wanted: str, tasks: Mapping[str, CellTask]) -> int:
    """Compute one cell in this process, to see why it fails."""
    for name, task in tasks.items():
        if wanted in (name, task.cell.slug):
            compute_here(task)
            print(f"finished: {task.directory / 'cells' / name}")
            return 0
    raise unknown("cell", wanted, (task.cell.slug for task in tasks.values()))


def conclude(options: Options, tasks: Mapping[str, CellTask], failures: Mapping[str, str], again: str) -> int:
    """Write the report and say how it went."""
    if len(failures) < len(tasks):
        from experiments.report import print_report

        print("writing the report", flush=True)
        print_report(options.directory)
        if options.placebo:
            from experiments.report import report_placebo

            report_placebo(options.directory)
    if failures:
        print(f"{len(failures)} of {len(tasks)} cells failed, all others are kept:", file=sys.stderr)
        for name, reason in failures.items():
            print(f"  {name}: {reason}\n    log: {tasks[name].folder / LOG}", file=sys.stderr)
            print(f"    to see it fail: {again} --cell {name}", file=sys.stderr)
        print(f"to try them again: {again}", file=sys.stderr)
        return 1
    return 0


def describe(options: Options, cells: Sequence[Cell], rates: Rates, workers: int) -> None:
    """Print what would be computed and how long it would take."""
    there = set(finished(options.directory))
    print(f"preset {options.preset}: {get_preset(options.preset).about}")
    print(f"results go to {options.directory}")
    layout = "{:<14}{:>8}{:>8}{:>9}{:>11}{:>10}{:>13}"
    print(layout.format("task", "level", "agents", "updates", "baselines", "finished", "core time"))
    total = 0.0
    for task, level in dict.fromkeys((cell.task, cell.level_name) for cell in cells):
        group = [cell for cell in cells if (cell.task, cell.level_name) == (task, level)]
        kinds = Counter(cell.kind for cell in group)
        left = sum(rates.seconds(cell) for cell in group if cell.name not in there)
        done = sum(cell.name in there for cell in group)
        updates = max(cell.updates for cell in group)  # further tests of agents are in the core time alone
        print(layout.format(task, level, kinds["agent"], updates, kinds["baseline"], done, duration(left)))
        total += left
    kinds = Counter(cell.kind for cell in cells)
    source = f"measured on {rates.measured} stored cells" if rates.measured else "by default rates"
    print(
        f"{kinds['agent']} agents and {kinds['baseline']} baselines; about "
        f"{duration(START + total / workers if total else 0.0)} left with {workers} processes ({source})"
    )


def words_of(arguments: Iterable[str]) -> list[str]:
    """`--tasks highway,u-turn` and `--policy A --policy B` as tyro takes them: with spaces, and each option once."""
    values: dict[str, list[str]] = {}
    name = ""
    for word in arguments:
        if word.startswith("--"):
            name, *given = word.split("=", 1)
        else:
            given = [word] if set("/=") & set(word) else word.split(",")
        values.setdefault(name, []).extend(given)
    return [word for name, given in values.items() for word in ([name] if name else []) + given]


def main() -> int:
    """The command line."""
    arguments = words_of(sys.argv[1:])
    options = tyro.cli(Options, args=arguments, description=__doc__, config=(tyro.conf.FlagCreatePairsOff,))
    return sweep(options, arguments=sys.argv[1:], validate=before_training)


if __name__ == "__main__":
    run_command(main, resumes=True)
