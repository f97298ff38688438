"""Film an agent: one test scenario at risk 0 and at risk 1, side by side.

    python experiments/watch.py results/mine
    python experiments/watch.py results/mine --agent u-turn-3-treatment --scenario 17

Both drives begin at the same places and speeds, by default those of the first scenario with a crash at risk 1.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from contextlib import closing
from dataclasses import dataclass
from typing import Annotated

import tyro

from experiments.backends import make_env
from experiments.reporting.showcase import ending
from experiments.reporting.tables import listing
from experiments.study.design.grid import tested_on
from experiments.study.design.traffic import ALL, TRAFFICS
from experiments.study.replaying.rerun import Case, play_again
from experiments.study.results.store import EPISODES, Store
from experiments.support.errors import UserError, run_command
from experiments.support.films import Film, check_gif, save_gif, side_by_side

VIEW = {"screen_width": 440, "screen_height": 280, "scaling": 3.4, "centering_position": [0.45, 0.65]}


@dataclass(frozen=True)
class Options:
    """Film an agent: one test scenario at risk 0 and at risk 1, side by side."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Directory of train.py or sweep.py."""
    agent: str = ""
    """A part of the agent's name; by default the agent that was trained last."""
    scenario: int | None = None
    """Number of the test scenario; by default the first one with a crash at risk 1."""
    code: Annotated[str | None, tyro.conf.arg(metavar="FILE:NAME")] = None
    """The agent's network or learner, if it is one of your own; code is run only where you name it."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """File to write; by default DIR/AGENT-SCENARIO.gif."""


def chosen(directory: Path, part: str) -> str:
    """The name of the agent's cell: of those that fit and have weights, the one that was finished last.

    Raises:
        UserError: there is none.
    """
    store = Store(directory)
    agents = store.agents()
    fitting = [name for name in agents if part in name]
    if not fitting:
        names = listing(sorted(agents), 5)
        raise UserError(f"no agent in {directory} has {part!r} in its name; there are: {names}")
    fitting = [name for name in fitting if store.weights(name)] or fitting
    return max(fitting, key=lambda name: str(agents[name]["timing"]["finished"]))


def watch(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    check_gif(options.out)
    name = chosen(options.directory, options.agent)
    store = Store(options.directory)
    record, table = store.record(name), store.tables(name)[EPISODES]
    key = record["key"]
    scenario = options.scenario
    if scenario is None:
        crashes = table[(table["traffic"] == "risky") & table["crashed"]]["scenario"]
        scenario = int((crashes if len(crashes) else table["scenario"]).min())
    films = []
    for traffic in TRAFFICS:
        backend, task, config = tested_on(key)
        with closing(make_env(backend, task, {**config, **VIEW}, "rgb_array")) as env:
            film = Film(env)
            at = table[(table["traffic"] == traffic) & (table["scenario"] == scenario)]
            stored = dict(at.iloc[0]) if len(at) else {"traffic": traffic, "scenario": scenario}
            row = play_again(Case(store, name, record, stored, options.code), env, film.frame)
        films.append((f"risk {ALL[traffic].dose:g}: {ending(row)}", film.pictures))
    file = options.out or options.directory / f"{name.rpartition('-')[0]}-{scenario}.gif"
    save_gif(side_by_side(films), file)
    print(f"{name}, scenario {scenario}: {'; '.join(title for title, _ in films)}")
    print(f"written: {file}")
    return 0


if __name__ == "__main__":
    run_command(lambda: watch(tyro.cli(Options, description=__doc__)))
