"""Film an agent among risky drivers, in a scenario that it survives.

    python experiments/watch.py results/mine
    python experiments/watch.py results/mine --agent u-turn-3-treatment --out film.mp4

Where an agent of the other training is stored beside it, both are filmed in the same risky scenario: control, trained
in regular traffic, and treatment, trained in risky traffic. An agent alone is filmed at risk 0 and at risk 1. All
drives begin at the same places and speeds. The caption says how often agents crash and how the scenario was chosen. The
next report of DIR shows the films that lie there.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from contextlib import closing
from dataclasses import dataclass
from difflib import SequenceMatcher
from typing import Annotated

import pandas as pd
import tyro

from experiments.backends import make_env
from experiments.reporting.tables import listing
from experiments.study.design.arms import ARMS
from experiments.study.design.cell import tested_on
from experiments.study.design.levels import OwnTasks
from experiments.study.design.traffic import ALL, TRAFFICS
from experiments.study.replaying.rerun import Case, ending, play_again
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store
from experiments.support.arguments import command
from experiments.support.errors import UserError
from experiments.support.films import Film, check_film, panel, save_film, side_by_side

NEARLY = "the first risky one with a near miss that the agent survives"
CRASHES = "the first risky one in which the agent crashes"


@dataclass(frozen=True)
class Options:
    """Film an agent among risky drivers, in a scenario that it survives."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Directory of train.py or sweep.py."""
    agent: str = ""
    """A part of the agent's name; by default the agent that was trained last."""
    scenario: int | None = None
    """Number of the test scenario; by default the first risky one with a near miss that the agent survives."""
    crash: bool = False
    """Show the first risky scenario in which the agent crashes."""
    code: Annotated[str | None, tyro.conf.arg(metavar="FILE:NAME")] = None
    """The agent's network or learner, if it is one of your own; code is run only where you name it."""
    tasks: OwnTasks = ()
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write, .gif or .mp4; by default DIR/AGENT-SCENARIO.gif."""


def chosen(directory: Path, part: str) -> str:
    """The name of the agent's cell: of those that fit and have weights, the one that was finished last.

    Raises:
        UserError: there is none.
    """
    store = Store(directory)
    agents = store.agents()
    fitting = [name for name in agents if part in name]
    if not fitting:
        names = listing(sorted(agents, key=lambda name: -SequenceMatcher(None, name, part).ratio()), 5)
        raise UserError(f"no agent in {directory} has {part!r} in its name; there are: {names}")
    fitting = [name for name in fitting if store.weights(name)] or fitting
    return max(fitting, key=lambda name: str(agents[name]["timing"]["finished"]))


def other_of(store: Store, name: str) -> str | None:
    """The agent that was trained in the other traffic, and is the same in all else; None if it is not stored."""
    agents = store.agents()
    key = agents[name]["key"]
    if key["arm"] not in ARMS:
        return None
    (other,) = set(ARMS) - {key["arm"]}
    alike = {**key, "arm": other}
    return next((cell for cell, record in agents.items() if record["key"] == alike), None)


def scenario_of(table: pd.DataFrame, options: Options) -> tuple[int, str]:
    """Which scenario is shown, and how it was chosen, in words."""
    if options.scenario is not None:
        return options.scenario, "chosen by hand"
    risky = table[table["traffic"] == "risky"].sort_values("scenario")
    close = risky["near_misses"] > 0
    crashes = risky["crashed"].astype(bool)
    for chosen, rule in (
        (crashes if options.crash else ~crashes & close, CRASHES if options.crash else NEARLY),
        (~crashes, "the first risky one that the agent survives"),
        (crashes, CRASHES),
    ):
        if chosen.any():
            return int(risky[chosen]["scenario"].iloc[0]), rule
    raise UserError("the agent has no risky test episodes: choose a scenario with --scenario")


def watch(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    check_film(options.out, ".gif", ".mp4")
    if options.scenario is not None and options.scenario < 0:
        raise UserError(f"--scenario counts from 0, not {options.scenario}")
    name = chosen(options.directory, options.agent)
    store = Store(options.directory)
    scenario, rule = scenario_of(store.tables(name)[EPISODES], options)
    arm, other = store.record(name)["key"]["arm"], other_of(store, name)
    if other is not None:
        cells = {arm: name, store.record(other)["key"]["arm"]: other}
        shown = [(each, cells[each], "risky") for each in ARMS]
    else:
        shown = [(f"risk {ALL[traffic].dose:g}", name, traffic) for traffic in TRAFFICS]
    films, rates = [], []
    for title, cell, traffic in shown:
        record, table = store.record(cell), store.tables(cell)[EPISODES]
        driven = table[table["traffic"] == traffic]
        backend, task, config = tested_on(record["key"])
        with closing(make_env(backend, task, {**config, **panel(task, config)}, "rgb_array")) as env:
            film = Film(env)
            at = driven[driven["scenario"] == scenario]
            stored = dict(at.iloc[0]) if len(at) else {"traffic": traffic, "scenario": scenario}
            row = play_again(Case(store, cell, record, stored, options.code), env, film.frame)
        films.append((f"{title}: {ending(row)}", film.pictures))
        rates.append(f"{title} in {driven['crashed'].mean():.0%} of {len(driven)}")
    where = "at risk 1" if other is not None else "by traffic"
    caption = [f"Crashes in test scenarios {where}: {', '.join(rates)}.", f"Scenario {scenario}: {rule}."]
    file = options.out or options.directory / f"{name.rpartition('-')[0]}-{scenario}.gif"
    save_film(side_by_side(films, caption=caption), file)
    print(f"{name}, scenario {scenario}: {'; '.join(title for title, _ in films)}", *caption, sep="\n")
    print(f"written: {file}")
    return 0


if __name__ == "__main__":
    command(watch, Options, __doc__)
