"""Put a policy through the frozen test, and write its card: how safely and how fast it drives, beside others.

    python experiments/evaluate.py results/mine                # the agent that train.py has trained
    python experiments/evaluate.py u-turn.zip --tasks u-turn   # a model of Stable-Baselines3; 'ppo-{task}.zip': of each
    python experiments/evaluate.py my_policy.py:make           # make(env) returns an object with act(observation)
    python experiments/evaluate.py treatment                   # published agents: an arm, or u-turn-3/treatment
    python experiments/evaluate.py careful                     # a driver of fixed rules; sumo: SUMO's own

Five tasks in the lightest and the densest traffic, among regular, risky and measured drivers and risky ones without
events: 200 scenarios each, the same ones for everybody (docs/benchmark.md). About ten minutes on two cores, with
--quick two. Writes card.json and card.html. --entry NAME also stores the card in results/entries.json. --film films
the crash of each task at the highest closing speed, beside a rule in the same scenario.

Other tasks are tested in the same way, on scenarios that are not frozen, beside drivers of fixed rules.

benchmark.py measures the speed of the simulators and has nothing to do with this test.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, Any

import pandas as pd
import tyro
from markupsafe import Markup

from agents.rules import POLICIES
from experiments.reporting.card import ALL, card_figure, part, rows, texts
from experiments.reporting.page import render
from experiments.study.compute.entrants import Entrant, Place, entrants
from experiments.study.compute.frozen_test import resolved, scenarios_of, take
from experiments.study.design.fingerprint import check_dynamics, dynamics
from experiments.study.design.levels import StudyTasks, tasks_known
from experiments.study.design.sheet import task_of
from experiments.study.replaying.crash import Crash, beside_another, worst_crashes
from experiments.support.arguments import Flag, argument, as_typed, command
from experiments.support.errors import UserError, check_known, check_least, writing
from experiments.support.files import read_json, sha256_bytes, write_file, write_json, write_lines
from experiments.support.films import save_gif
from experiments.support.provenance import provenance
from sumo_env.benchmark import SETTINGS, SIZE, BenchmarkScenario, levels_of, stored

ENTRIES = Path(__file__).resolve().parents[1] / "results" / "entries.json"
CARD, PAGE = "card.json", "card.html"
Card = Mapping[str, Any]


@dataclass(frozen=True)
class Options:
    """Put a policy through the frozen test, and write its card."""

    policy: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="POLICY")]
    """A directory of train.py or sweep.py, a zip file of Stable-Baselines3, FILE:MAKE, a published agent or a rule."""
    tasks: StudyTasks = ()
    """Some tasks; by default those that the policy was trained for, or the five of the frozen test."""
    agent: str = ""
    """A part of the agent's name in the directory; by default the agent that was trained last."""
    quick: bool = False
    """40 scenarios of each kind in place of 200."""
    film: Flag = False
    """Film the worst crash of each task, the one at the highest closing speed, beside the first of careful, sumo and
    slower that does not crash there: POLICY-TASK.gif in the directory of the card."""
    workers: Annotated[int | None, argument("N", "the number of cores")] = None
    """Processes."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/card")
    """Directory for card.json and card.html, which are written anew."""
    entry: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """Store the card in results/entries.json, to be committed; NAME is what the driver is called there."""


def drivers(options: Options) -> dict[Place, Entrant]:
    """Who drives at each task and level of the test.

    Raises:
        UserError: there is no such policy or task, or it was not trained for one.
    """
    check_known("task", options.tasks, tasks_known())
    check_least(options, workers=1)
    places = [(task, level) for task in options.tasks or tasks_known() for level in levels_of(task_of(task))]
    who = entrants(options.policy, places, options.agent)
    if not options.tasks:
        who = {at: one for at, one in who.items() if one.place or at[0] in SETTINGS}
    if strange := [task for task in options.tasks if task not in {name for name, _ in who}]:
        raise UserError(f"{options.policy} cannot drive {', '.join(strange)}: leave it out of --tasks")
    if not who:
        raise UserError(f"no agent of {options.policy} was trained for {', '.join(tasks_known())}")
    return who


def evaluated(
    options: Options, arguments: Sequence[str]
) -> tuple[dict[str, Any], dict[str, Card], list[Crash]]:
    """Drive the test.

    Returns:
        The card; of tasks that are not frozen those of drivers of fixed rules, by name; each task's worst crash.

    Raises:
        UserError: as `drivers`, the policy does not fit an environment, or nothing could be driven.
    """
    who = drivers(options)
    tasks = tuple(dict.fromkeys(task for task, _ in who))
    scenarios = [one for task in tasks for one in scenarios_of(task, options.quick)]
    with writing(options.out):  # before minutes of driving
        pass
    check_dynamics(("sumo", task_of(task)) for task in tasks)
    groups = {group: list(own) for group, own in groupby(scenarios, lambda one: one.group)}
    who = resolved(who, groups)
    driven, failed = take(who, groups, options.workers)
    found = list(rows(whole(driven))) if driven else []
    if not found:
        raise UserError(next(iter(failed.values())))
    frozen = {group: stored(group, options.quick) for group in driven}
    card = {
        "name": options.entry or Path(options.policy).name,
        "command": as_typed("evaluate", arguments),
        "date": time.strftime("%Y-%m-%d"),
        "scenarios": len(scenarios) // len(groups),
        "drivers": {f"{task} {level}": one.name for (task, level), one in who.items()},
        "digests": {f"{task} {level}": one.digest for (task, level), one in who.items()},
        "set": {task: identity(task) for task in tasks},
        "changed": [group for group, digest in frozen.items() if digest and driven[group][1] != digest],
        "failed": failed,
        "provenance": provenance(),
        "rows": found,
    }
    others = {group: own for group, own in groups.items() if own[0].task not in SETTINGS}
    return card, beside(others, card, options.workers), worst_crashes(who, groups, driven)


def beside(groups: Mapping[str, list[BenchmarkScenario]], card: Card, workers: int | None) -> dict[str, Card]:
    """The cards of drivers of fixed rules in these groups of scenarios, by name; of a rule that fits."""
    found: dict[str, Card] = {}
    for rule in POLICIES if groups else ():
        places = {(own[0].task, own[0].level) for own in groups.values()}
        try:
            who = resolved(entrants(rule, places), groups)
        except UserError as error:
            print(f"not beside {rule}: {error}")
            continue
        print(f"beside {rule}:")
        driven, _ = take(who, groups, workers)
        found[rule] = {"set": card["set"], "rows": list(rows(whole(driven)))}
    return found


def whole(driven: Mapping[str, tuple[pd.DataFrame, str]]) -> pd.DataFrame:
    """All episodes of the tasks and traffics of which every level was driven: a mean is over all of them."""
    episodes = pd.concat(frame for frame, _ in driven.values())
    levels = episodes.groupby(["task", "traffic"])["level"].transform("nunique")
    return episodes[levels == episodes["task"].map(lambda task: len(levels_of(task_of(task))))]


def identity(task: str) -> str:
    """What two cards have to have in common to be compared in a task: the frozen scenarios, and what SUMO does."""
    groups = dict.fromkeys(one.group for one in scenarios_of(task, quick=True))
    return sha256_bytes(" ".join([*map(stored, groups), dynamics("sumo", task_of(task))]).encode())[:8]


def entries() -> dict[str, Card]:
    """The cards that are stored, by name."""
    return read_json(ENTRIES) if ENTRIES.exists() else {}


def page(card: Card, others: Mapping[str, Card]) -> str:
    """card.html."""
    name = card["name"]
    cards = {name: card, **({} if card["changed"] else {**others, name: card})}
    frame = texts(cards, card["set"])
    own = part(frame, driver=name)
    beside = {
        (task, traffic): part(frame, task=task, traffic=traffic, level=ALL)
        for task, traffic in zip(own["task"], own["traffic"], strict=True)
        if len(cards) > 1
    }
    more = [task for task in card["set"] if task not in SETTINGS]
    figure = card_figure(cards, card["set"], name) if beside else None
    shown = {"own": own, "beside": beside, "figure": figure and Markup(figure)}
    return render({"card": card, "full": SIZE, "more": more, **shown}, "card.html.j2")


def evaluate(options: Options, arguments: Sequence[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    card, rules, crashes = evaluated(options, arguments)
    others = entries()
    for name, rule in rules.items():
        known = others.get(name, {"rows": [], "set": {}})
        others[name] = {"rows": [*known["rows"], *rule["rows"]], "set": {**known["set"], **rule["set"]}}
    with writing(options.out):
        write_json(options.out / CARD, card)
        write_file(options.out / PAGE, page(card, others).encode())
    shown = part(texts({"": card}, card["set"]), driver="", level=ALL)
    met = sum(bool(other["set"].items() & card["set"].items()) for other in others.values())
    print(f"{shown.to_string(index=False)}\nmeans of {', '.join(card['drivers'])}")
    print(f"card, beside {met} others: {options.out / PAGE}")
    if card["changed"]:
        print(f"not the frozen scenarios: {', '.join(card['changed'])} are drawn otherwise by this code")
    for group, reason in card["failed"].items():
        print(f"{group} was not driven: {reason}", file=sys.stderr)
    for crash in crashes if options.film else ():
        name = re.sub(r"[^\w.-]", "-", card["name"].removesuffix(".zip"))
        file = options.out / f"{name}-{crash.scenario.task}.gif"
        save_gif(beside_another(crash, card["name"]), file)
        print(f"film of the crash at the highest closing speed: {file}")
    if options.entry:
        if card["changed"] or card["failed"] or {*card["set"]} - {*SETTINGS}:
            raise UserError("--entry stores complete cards of the frozen scenarios alone")
        write_lines(ENTRIES, {**entries(), options.entry: card})
    return 1 if card["failed"] else 0


if __name__ == "__main__":
    command(lambda options: evaluate(options, sys.argv[1:]), Options, __doc__)
