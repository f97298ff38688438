"""Play one stored test episode again, check it against the stored one, and draw it or export it for sumo-gui.

    python experiments/replay.py results/sumo-quick/cells/sumo-highway-50-control-s0
    python experiments/replay.py results/sumo-quick/cells/sumo-highway-50-control-s0:risky:17
    python experiments/replay.py CASE --gif       # an animation instead of a sheet of pictures
    python experiments/replay.py CASE --sumo      # a folder with episode.sumocfg, for sumo and sumo-gui

Exit status: 0 the episode was reproduced, 1 it came out differently (the message says what, and which
versions have changed since), 2 the case does not exist.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.study.arms import TRAFFICS
from experiments.support.threads import limit_threads

limit_threads()

import difflib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import pandas as pd
import tyro
from numpy.typing import NDArray
from PIL import Image

from experiments.backends import make_env
from experiments.study import grid, store
from experiments.study.cell import MakeEnv
from experiments.study.evaluate import play
from experiments.study.rerun import changed_versions, differences, stored_policy
from experiments.support.errors import UserError, disk_error, run_command
from experiments.support.films import Film, Pictures, save_gif

PICTURES = 12  # on a sheet, spread over the episode
SUGGESTED = 5  # names in an error


@dataclass(frozen=True)
class Options:
    """Play one stored test episode again."""

    case: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="CASE")]
    """DIR/cells/CELL[:TRAFFIC:SCENARIO]; the beginning of a cell's name is enough if no other begins so. Traffic is
    regular or risky, scenarios count from 0; by default the first crash."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """File (or folder) to write; by default CELL-TRAFFIC-SCENARIO with a fitting ending, in the current directory."""
    gif: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Write a film in real time (GIF) instead of a sheet of pictures (PNG)."""
    sumo: Annotated[bool, tyro.conf.arg(help_behavior_hint="")] = False
    """Write a folder that sumo and sumo-gui open instead: network, vehicles, the ego's way, and configurations."""


@dataclass(frozen=True)
class Case:
    """A stored test episode."""

    path: Path
    traffic: str
    scenario: int

    @property
    def name(self) -> str:
        """What its files are called."""
        return f"{self.path.name}-{self.traffic}-{self.scenario}"

    @property
    def table(self) -> pd.DataFrame:
        """The stored test of its cell."""
        return store.tables_of(self.path.parents[1], self.path.name)[store.EPISODES]


def parse_case(text: str) -> Case:
    """Find the cell, traffic and scenario of a case; by default the cell's first crash.

    Raises:
        UserError: not of that form, or the cell does not exist.
    """
    match = re.fullmatch(r"(?P<path>.+?)(:(?P<traffic>[a-z]+):(?P<scenario>\d+))?/?", text)
    if match is None:
        raise UserError(f"a case is DIR/cells/CELL[:TRAFFIC:SCENARIO], not {text!r}")
    path = Path(match["path"])
    if match["traffic"] and match["traffic"] not in TRAFFICS:
        raise grid.unknown("traffic", match["traffic"], TRAFFICS)
    home = path.parents[1] if len(path.parents) > 1 else Path()
    names = store.finished(home) if path.parent.name == "cells" else []
    if not names:
        raise UserError(f"there is no cell {path}")
    case = Case(
        path.with_name(find_cell(path.name, names)),
        match["traffic"] or "regular",
        int(match["scenario"] or 0),
    )
    if match["traffic"] is None:
        crashes = case.table[case.table["traffic"].isin(list(TRAFFICS)) & case.table["crashed"]]
        for row in crashes.head(1).itertuples():
            return replace(case, traffic=str(row.traffic), scenario=int(row.scenario))
    return case


def find_cell(word: str, names: Sequence[str]) -> str:
    """The cell with this name, or the only one whose name begins so.

    Raises:
        UserError: none or several; the nearest five are named.
    """
    if word in names:
        return word
    fitting = [name for name in names if name.startswith(word)]
    if len(fitting) == 1:
        return fitting[0]
    near = fitting or difflib.get_close_matches(word, names, n=SUGGESTED, cutoff=0.3)
    what = (
        f"{len(fitting)} cells begin with {word!r}"
        if fitting
        else f"none of {len(names)} cells begins with {word!r}"
    )
    more = ", ..." if len(near) > SUGGESTED else ""
    raise UserError(f"{what}; did you mean {', '.join(near[:SUGGESTED])}{more}?" if near else what)


def replay(options: Options, make_env: MakeEnv = make_env) -> int:
    """Do what the options ask for; returns the exit status.

    Raises:
        UserError: the case does not exist, its cell is damaged, or the file cannot be written.
    """
    case = parse_case(options.case)
    record, table = store.read_stored(case.path.parents[1], case.path.name), case.table
    key = record["key"]
    rows = table[(table["traffic"] == case.traffic) & (table["scenario"] == case.scenario)]
    if rows.empty:
        raise UserError(
            f"{case.path.name} has {key['eval']['episodes']} scenarios, counted from 0: no {case.scenario}"
        )
    env = make_env(key["backend"], key["task"], key["env_config"], "rgb_array")
    try:
        film = Film(env, between=options.gif)
        seen, policy = stored_policy(case.path, record, env, rows.iloc[0].get("actions"))
        row = play(
            seen,
            policy,
            key["task"],
            key["level"],
            case.traffic,
            case.scenario,
            None if options.sumo else film.frame,
        )
        written = _write(options, case, env, film.pictures)
    except OSError as error:
        raise disk_error(error, options.out or Path.cwd()) from None
    finally:
        env.close()
    print(f"{case.name}: return {row['return']:.3f} in {row['length']} steps, " + _ending(row))
    print("crashes in the stored test: " + _crashes(table))
    print(f"written: {written}")
    wrong = differences(rows.iloc[0].to_dict(), row)
    if wrong:
        print(f"error: not reproduced: {'; '.join(wrong)}{_changed(record)}", file=sys.stderr)
        return 1
    print("reproduced: every stored number came out the same")
    return 0


def _ending(row: dict[str, Any]) -> str:
    if row["crashed"]:
        return f"{row['crash_type']} crash with {row['crash_other']} after {row['crash_time']:.1f} s"
    return "arrived" if row["arrived"] else "time was up"


def _crashes(table: Any) -> str:
    """Scenarios with a crash, for the next call."""
    parts = []
    for traffic in TRAFFICS:
        numbers = table[(table["traffic"] == traffic) & table["crashed"]]["scenario"].tolist()
        shown = " ".join(map(str, numbers[:12])) + (" ..." if len(numbers) > 12 else "")
        parts.append(f"{traffic} {shown or 'none'}")
    return "; ".join(parts)


def _changed(record: dict[str, Any]) -> str:
    """Versions that differ from those of the stored cell, in words."""
    changed = changed_versions(record)
    return f"; since then changed: {', '.join(changed)}" if changed else "; the versions are the same"


def sheet(frames: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures of one size on one sheet, row by row from the left, in as many columns as make it about square."""
    height, width, _ = frames[0].shape
    columns = max(1, round(math.sqrt(len(frames) * height / width)))
    rows = -(-len(frames) // columns)
    gap = 4  # [px]
    paper = np.full((rows * (height + gap) - gap, columns * (width + gap) - gap, 3), 255, np.uint8)
    for number, frame in enumerate(frames):
        top, left = number // columns * (height + gap), number % columns * (width + gap)
        paper[top : top + height, left : left + width] = frame
    return paper


def _write(options: Options, case: Case, env: gym.Env[Any, Any], pictures: Pictures) -> Path:
    path = options.out or Path(case.name + ("" if options.sumo else ".gif" if options.gif else ".png"))
    if options.sumo:
        env.unwrapped.export(path)  # type: ignore[attr-defined]
        return path / "episode.sumocfg"
    if options.gif:
        save_gif(pictures, path)
    else:
        chosen = np.unique(np.linspace(0, len(pictures) - 1, PICTURES).round().astype(int))
        Image.fromarray(sheet([np.asarray(pictures[number]) for number in chosen])).save(path)
    return path


if __name__ == "__main__":
    run_command(
        lambda: replay(tyro.cli(Options, description=__doc__, config=(tyro.conf.FlagCreatePairsOff,)))
    )
