"""Play one stored test episode again, check it against the stored one, and film it or export it for sumo-gui.

    python experiments/replay.py results/sumo-quick/cells/sumo-highway-50-control-s0
    python experiments/replay.py results/sumo-quick/cells/sumo-highway-50-control-s0:risky:17
    python experiments/replay.py CASE --policy    # the agent itself drives again
    python experiments/replay.py CASE --sumo      # a folder with episode.sumocfg, for sumo and sumo-gui
    python experiments/replay.py CASE --avoid     # until when could its crash have been avoided, and a film of both

The stored actions are played: this checks the simulator, and not the agent. --policy drives the agent from its weights
(in the folder, or published in agents.npz) and compares its actions too.

--avoid tries every sequence of --horizon actions from each policy step before the contact, in copies of the episode
with its own future: an upper bound of what a driver could do. Avoided means no contact for 5 s, or until the episode
ends; where the horizon is shorter than 5 s, IDLE or SLOWER is repeated after it.

Exit status: 0 the episode was reproduced, 1 it came out differently (the message says what, and which
versions have changed since) or no way around the crash was found, 2 the case does not exist or has no crash.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import copy
import math
import re
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Annotated, Any

import gymnasium as gym
import tyro

from experiments import backends
from experiments.backends import MakeEnv
from experiments.study.design.cell import tested_on
from experiments.study.design.levels import OwnTasks
from experiments.study.replaying.avoid import HORIZON, SAFE, rewound, way_out
from experiments.study.replaying.rerun import Case, changed_versions, differences, ending, play_again
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store, find_cell
from experiments.support.arguments import Flag, command
from experiments.support.errors import UserError, check_known, check_least
from experiments.support.films import Film, Pictures, check_film, save_gif, side_by_side


@dataclass(frozen=True)
class Options:
    """Play one stored test episode again."""

    case: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CASE")]
    """DIR/cells/CELL[:TRAFFIC:SCENARIO]; the beginning of a cell's name is enough if no other begins so. Traffic is
    regular, risky or another that the cell was tested in, scenarios count from 0; by default the first crash."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """File (or folder) to write; by default CELL-TRAFFIC-SCENARIO with a fitting ending, in DIR."""
    sumo: Flag = False
    """Write a folder that sumo and sumo-gui open instead of a film (GIF): network, vehicles and the ego's way."""
    policy: Flag = False
    """Drive the agent itself instead of the actions that it chose then."""
    avoid: Flag = False
    """Search for actions that would have avoided the crash; writes DIR/CELL-TRAFFIC-SCENARIO-avoided.gif."""
    code: Annotated[str | None, tyro.conf.arg(metavar="FILE:NAME", help_behavior_hint="")] = None
    """The cell's own policy, network or learner, for --policy; code is run only where you name it."""
    tasks: OwnTasks = ()
    horizon: int = HORIZON
    """Policy steps in which --avoid tries all sequences of actions."""


def parse_case(text: str, code: str | None = None) -> Case:
    """Find the cell, traffic and scenario of a case; by default the cell's first crash.

    Raises:
        UserError: not of that form, or there is no such cell or scenario.
    """
    match = re.fullmatch(r"(?P<path>(.*/)?[^:/]+)(:(?P<traffic>[a-z0-9-]+):(?P<scenario>\d+))?/?", text)
    if match is None:
        raise UserError(f"a case is DIR/cells/CELL[:TRAFFIC:SCENARIO], not {text!r}")
    path = Path(match["path"]).absolute()
    store = Store(path.parent.parent)
    names = store.finished() if path.parent.name == "cells" else []
    if not names and (there := Store(path).finished()):
        raise UserError(
            f"{text} is a folder of results: name one of its cells, such as {path / 'cells' / there[0]}"
        )
    if not names:
        raise UserError(f"there is no cell {path}")
    name = find_cell(path.name, names)
    test = store.tables(name)[EPISODES]
    rows = test.sort_values("crashed", ascending=False, kind="stable")
    if match["traffic"]:
        check_known("traffic", [match["traffic"]], test["traffic"].unique())
        rows = rows[(rows["traffic"] == match["traffic"]) & (rows["scenario"] == int(match["scenario"]))]
    if rows.empty:
        first, last = test["scenario"].min(), test["scenario"].max()
        raise UserError(f"{name} has the scenarios {first} to {last}: no {match['scenario']}")
    return Case(store, name, store.record(name), dict(rows.iloc[0]), code)


def replay(options: Options, make_env: MakeEnv = backends.make_env) -> int:
    """Do what the options ask for; returns the exit status."""
    check_least(options, horizon=1)
    if options.avoid and options.sumo:
        raise UserError("--avoid writes a film of its own: leave out --sumo")
    if options.avoid and options.policy:
        raise UserError("--avoid searches from the stored actions: leave out --policy")
    if not options.sumo:
        check_film(options.out, ".gif")
    case = parse_case(options.case, options.code)
    key, act = case.record["key"], _avoid if options.avoid else _again
    with closing(make_env(*tested_on(key), "rgb_array")) as env:
        return act(options, case, env)


def _again(options: Options, case: Case, env: gym.Env[Any, Any]) -> int:
    """Play an episode and write what was asked for; 1 if it came out differently."""
    film = None if options.sumo else Film(env)
    row = play_again(case, env, film.frame if film else None, options.policy)
    path = options.out or case.store.directory / (f"{case.name}.gif" if film else case.name)
    if film:
        save_gif(film.pictures, path)
    else:
        env.unwrapped.export(path)  # type: ignore[attr-defined]
        path = path / "episode.sumocfg"
    print(f"{case.name}: return {row['return']:.3f} in {row['length']} steps, {ending(row)}{_hit(row)}")
    test = case.store.tables(case.cell)[EPISODES]
    for traffic in test["traffic"].unique():
        crashes = test.loc[(test["traffic"] == traffic) & test["crashed"], "scenario"]
        print(f"stored crashes in {traffic} traffic, scenarios: {' '.join(map(str, crashes)) or 'none'}")
    print(f"written: {path}")
    if wrong := differences(case.row, row):
        changed = ", ".join(changed_versions(case.record)) or "no version"
        print(f"error: not reproduced: {'; '.join(wrong)}; since then changed: {changed}", file=sys.stderr)
        if options.policy and case.record["key"]["kind"] == "agent" and case.store.weights(case.cell) is None:
            print(
                "the agent's weights are published ones, which are rounded: it may choose otherwise where two actions "
                "are worth nearly the same (11 of 200 episodes); without --policy the stored actions are played",
                file=sys.stderr,
            )
        return 1
    if options.policy:
        print("reproduced: the agent chose the stored actions, and every stored number came out the same")
    else:
        print(
            "reproduced from the stored actions: every number came out the same (--policy drives the agent itself)"
        )
    return 0


def _hit(row: Mapping[str, Any]) -> str:
    return f", with {row['crash_other']}" if row["crashed"] else ""


def _avoid(options: Options, case: Case, env: gym.Env[Any, Any]) -> int:
    """Search the last moment from which a crash can be avoided; 1 if there is none."""
    inner: Any = env.unwrapped
    with rewound(case, env) as (copies, driven):
        contact, frequency = float(case.row["crash_time"]), inner.config["policy_frequency"]
        print(f"{case.name}: {ending(case.row)}{_hit(case.row)}")
        for step in reversed(range(len(driven))):
            time = step / frequency
            print(f"from {time:4.1f} s, {contact - time:.1f} s before the contact: ", end="", flush=True)
            free, contacts = way_out(copies[step], options.horizon)
            if free is not None:
                break
            steps = min(options.horizon, math.ceil(SAFE * frequency))
            print(f"not found: all sequences of {steps} actions end in a contact ({contacts} different ones)")
        else:
            print("not found: no searched sequence avoids the contact, from the first step on")
            return 1
        words = " ".join(inner.actions[action] for action in free)
        end = "" if len(free) >= SAFE * frequency else " (then the episode ends)"
        print(f"avoided by {words}{end}; contacts on the way: {contacts}")
        print(
            f"point of no return: {time:g} s, {contact - time:.1f} s before the contact "
            f"(the ego decides every {1 / frequency:g} s)"
        )
        begin = max(step - 2 * frequency, 0)
        drives = {
            f"as stored: contact after {contact:.1f} s": driven[begin:],
            f"avoided from {time:g} s on: {words}": driven[begin:step] + free,
        }
        films = [(title, filmed(copies[begin], actions)) for title, actions in drives.items()]
    width, height = films[0][1][0].size
    path = options.out or case.store.directory / f"{case.name}-avoided.gif"
    save_gif(side_by_side(films, columns=1 if width > height else 2), path)
    print(f"written: {path}")
    return 0


def filmed(env: gym.Env[Any, Any], actions: Iterable[int]) -> Pictures:
    """What these actions do in a copy of an environment."""
    with closing(copy.deepcopy(env)) as twin:
        film = Film(twin)
        film.frame()
        for action in actions:
            twin.step(action)
            film.frame()
        return film.pictures


if __name__ == "__main__":
    command(replay, Options, __doc__)
