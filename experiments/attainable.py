"""Say what can be had in a setting before anybody learns there: without foresight, and by knowing the future.

    python experiments/attainable.py                                       # knowing the future: 30 minutes on a core
    python experiments/attainable.py --tasks two-way two-way-brakes --levels 1 3 --scenarios 24
    python experiments/attainable.py --backend sumo --tasks u-turn         # drivers without foresight

On the replica (--backend replica) a beam search looks for the best sequence of actions of each scenario in copies of
the episode, so that it knows the future. Its returns are lower bounds, and more than any policy can be expected to
reach. A setting in which most scenarios have no sequence without a crash cannot be driven: the actions, not the
learner, are too little.

On SUMO (--backend sumo) drive each constant action, the drivers of fixed rules, the planner in imagined copies (dear:
40 scenarios), SUMO's own driver, and agents that are named by --policies. The best constant action is score 0 of the
setting, the best driver that has no more actions than the agents is score 1.

The scenarios are those of no test and no training. Writes found.json; --update also stores what was found in
results/attainable.json, by which reports score returns. The same command run again goes on where it was stopped.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any, Literal

import gymnasium as gym
import pandas as pd
import tyro

from agents.rules import CAUTIONS
from experiments.backends import make_env
from experiments.study.compute.attainable import Batch, always
from experiments.study.compute.batches import driven
from experiments.study.compute.entrants import Entrant, entrant_of, several
from experiments.study.compute.executors import EXECUTORS
from experiments.study.compute.foresight import WIDTH
from experiments.study.design import attainable
from experiments.study.design.attainable import CONSTANT, MORE, POLICY, SEARCH, place
from experiments.study.design.experiment import MOST
from experiments.study.design.fingerprint import check_dynamics, dynamics
from experiments.study.design.levels import StudyTasks, choose_levels, choose_tasks, env_config, level_names
from experiments.study.design.sheet import GRID, VARIANTS, task_of
from experiments.study.design.traffic import TRAFFICS
from experiments.support.arguments import argument, as_typed, command
from experiments.support.errors import UserError, check_known, check_least, writing
from experiments.support.files import plain_json, write_json, write_lines
from experiments.support.provenance import provenance

RULE_DRIVERS = ("idm", *CAUTIONS)
PLANNER, BY_SUMO = "planner", "sumo"
SCENARIOS = {"replica": 48, "sumo": 200}  # of each setting and traffic, unless the user says otherwise
SIZES, SIZE = {PLANNER: 5, SEARCH: 8}, 50  # scenarios of a batch


@dataclass(frozen=True)
class Options:
    """Say what can be had in a setting, before anybody learns there."""

    backend: Literal["replica", "sumo"] = "replica"
    """replica: the best sequences of actions, knowing the future. sumo: drivers without foresight."""
    tasks: StudyTasks = ()
    levels: Annotated[tuple[int, ...], argument("LEVEL ...", "all")] = ()
    """Traffic levels by number; 1 is the lightest."""
    scenarios: Annotated[int | None, argument("N", "48; on SUMO 200, of the planner 40")] = None
    """Scenarios in each of the two traffics."""
    width: int = WIDTH
    """States that the search keeps after each step."""
    policies: Annotated[tuple[str, ...], argument("POLICY ...")] = ()
    """Agents that drive on SUMO as well: published ones (control), a directory of results, or DIR/PART: all agents of
    the setting in it that have PART in their names."""
    executor: Annotated[str, argument("NAME")] = "local"
    """Where is computed: local (processes of this machine), ray or slurm (docs/clusters.md)."""
    workers: Annotated[int | None, argument("N", "the number of cores")] = None
    """Batches at a time."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/attainable")
    """Directory for the results, whose found.json is written anew."""
    update: bool = False
    """Also store what was found in results/attainable.json, to be committed."""


NONE, FOUND = "-", "found.json"
Found = dict[str, dict[str, Any]]  # by place


def drivers(options: Options, task: str, level: int) -> Iterator[tuple[Entrant | None, str]]:
    """Who drives in a setting, and of which kind. Raises UserError for an agent that is not there or does not fit."""
    if options.backend == "replica":
        yield None, SEARCH
        return
    with closing(environment(task, level)) as env:
        inner: Any = env.unwrapped
        for action in inner.actions.values():
            yield always(action).resolved(env), CONSTANT
        for name in (*RULE_DRIVERS, PLANNER, BY_SUMO):
            # whoever may stand still has all speeds of SUMO's driver
            has_more = name == BY_SUMO and min(inner.target_speeds) > 0
            yield (
                entrant_of(name, task, level_names(task)[level - 1]).resolved(env),
                MORE if has_more else POLICY,
            )
    for policies in options.policies:
        for entrant in several(policies, task, level_names(task)[level - 1]):
            with closing(environment(task, level, entrant)) as env:
                yield entrant.resolved(env), POLICY


def environment(task: str, level: int, driver: Entrant | None = None) -> gym.Env[Any, Any]:
    """Of a setting on SUMO, as an agent observes it."""
    return make_env("sumo", task_of(task), env_config("sumo", task, level, driver.config if driver else {}))


def batches(options: Options) -> tuple[list[Batch], list[str]]:
    """What the options ask for, and of each batch the kind of its driver.

    Raises:
        UserError: something does not exist or makes no sense, before anything is driven.
    """
    check_known("executor", [options.executor], EXECUTORS)
    check_least(options, scenarios=2, workers=1, width=1)
    if options.policies and options.backend == "replica":
        raise UserError("--policies drive on SUMO: add --backend sumo")
    tasks = choose_tasks(options.tasks or (*GRID, *VARIANTS), variants=True)
    check_dynamics((options.backend, task) for task in dict.fromkeys(map(task_of, tasks)))
    found, kinds = list[Batch](), list[str]()
    for task, level in [(task, k) for task, own in choose_levels(tasks, options.levels).items() for k in own]:
        known = dynamics(options.backend, task_of(task))
        for driver, kind in drivers(options, task, level):
            config = env_config(options.backend, task, level, driver.config if driver else {})
            name, width = (driver.name, 0) if driver else (SEARCH, options.width)
            scenarios = options.scenarios or SCENARIOS[options.backend]
            count, size = min(scenarios, MOST.get(name, scenarios)), SIZES.get(name, SIZE)
            for traffic, first in product(TRAFFICS, range(0, count, size)):
                what = task, level, traffic, config, known, driver, width
                found.append(Batch(options.out, *what, first, min(size, count - first)))
                kinds.append(kind)
    return found, kinds


def summary(rows: pd.DataFrame) -> dict[str, Any]:
    """What is stored of the episodes of a driver, or of the best sequences, in one place."""
    value = rows["return"]
    means = {"return": value.mean(), "return_se": value.sem(), "crashed": rows["crashed"].mean()}
    return {"scenarios": len(rows), **means}


def places(options: Options, asked: Sequence[Batch], kinds: Sequence[str], rows: pd.DataFrame) -> Found:
    """What was found, by place as it is stored in `attainable.FILE`."""
    of = [place(one.task, level_names(one.task)[one.level - 1], one.traffic) for one in asked]
    keys = pd.DataFrame({"place": of, "driver": [one.who for one in asked], "kind": kinds})
    repeated = keys.loc[keys.index.repeat([one.count for one in asked])].reset_index(drop=True)
    found: Found = {one: {options.backend: batch.dynamics} for one, batch in zip(of, asked, strict=True)}
    for (name, driver, kind), own in pd.concat([repeated, rows], axis=1).groupby([*keys], sort=False):
        if driver == SEARCH:
            safe = own["safe_return"]
            of_safe = {"no_safe": safe.isna().mean(), "safe_return": safe.mean()}
            found[name][SEARCH] = {"width": options.width, **summary(own), **of_safe}
        else:
            found[name].setdefault("drivers", {})[driver] = {"kind": kind, **summary(own)}
    return plain_json(found, digits=8)


def table(found: Found) -> pd.DataFrame:
    """What is printed: a line a place."""
    lines = []
    for name, of in found.items():
        line = {"setting and traffic": name}
        if one := of.get(SEARCH):
            line["scenarios"] = one["scenarios"]
            line["no safe sequence"] = f"{one['no_safe']:.0%}"
            line["best return"] = f"{one['return']:.2f} ± {one['return_se']:.2f}"
            line["ends in a crash"] = f"{one['crashed']:.0%}"
            if one["safe_return"] is not None:
                line["best without one"] = f"{one['safe_return']:.2f}"
        for title, kind in (("score 0", CONSTANT), ("score 1", POLICY), ("more actions", MORE)):
            drove = {driver: one for driver, one in of.get("drivers", {}).items() if one["kind"] == kind}
            if drove:
                best = max(drove, key=lambda driver: drove[driver]["return"])
                line[title] = f"{best} {drove[best]['return']:.2f} ({drove[best]['crashed']:.0%} crash)"
        lines.append(line)
    return pd.DataFrame(lines).fillna(NONE)


def run(options: Options, arguments: Sequence[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    asked, kinds = batches(options)
    with writing(options.out):
        rows = driven(asked, options.executor, options.workers, "batches")
        found = places(options, asked, kinds, rows)
        record = {"command": as_typed("attainable", arguments), "places": found}
        write_json(options.out / FOUND, {**record, "provenance": provenance()})
    if options.update:
        before = attainable.stored()
        known = {name: {**before.get(name, {}), **found.get(name, {})} for name in {**before, **found}}
        write_lines(attainable.FILE, known)
        attainable.stored.cache_clear()
    print(table(found).to_string(index=False))
    if undrivable := attainable.undrivable(found):
        print(f"cannot be driven, no safe sequence in most scenarios: {', '.join(undrivable)}")
    print(f"written: {options.out / FOUND}")
    return 0


if __name__ == "__main__":
    command(lambda options: run(options, sys.argv[1:]), Options, __doc__, resumes=True)
