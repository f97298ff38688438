"""How many of an experiment's crashes could have been avoided 1, 2 and 3 s before the contact (see `avoid`)."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from experiments.study.arms import TRAFFICS
from experiments.study.avoid import SAFE, Rewound, Search
from experiments.study.cell import MakeEnv
from experiments.study.evaluate import COLUMNS, share
from experiments.study.rows import fill
from experiments.study.store import Results
from experiments.support.errors import UserError
from experiments.support.files import canonical_json

if TYPE_CHECKING:
    import gymnasium as gym
    import pandas as pd

BEFORE = (1.0, 2.0, 3.0)  # [s] before the contact
GROUP = ["backend", "task", "level_name", "arm"]
SEED = 0  # of the sample


def sample(results: Results, crashes: int) -> pd.DataFrame:
    """Up to so many crashes of each setting and arm, drawn among all of its agents, scenarios and both traffics.

    A larger sample begins with the smaller ones. Agents count whose weights are here, or whose actions are stored.

    Raises:
        UserError: there is no such crash.
    """
    rows = results.episodes
    rows = rows[(rows["kind"] == "agent") & rows["crashed"] & rows["traffic"].isin(list(TRAFFICS))]
    here = rows["cell"].map({cell: results.weights(cell) is not None for cell in rows["cell"].unique()})
    if "actions" in rows:
        here |= rows["actions"].str.fullmatch(r"\d+").fillna(False)
    if not here.any():
        raise UserError(
            f"{results.directory} has {len(rows)} crashes of agents, and neither weights nor actions of any: "
            "name a folder with weights, such as that of your own sweep"
        )
    drawn = rows[here.astype(bool)].sample(frac=1.0, random_state=SEED)
    number = drawn.groupby(GROUP).cumcount()
    return drawn.assign(number=number)[number < crashes].sort_values(["number", *GROUP])


def judge_all(
    results: Results, crashes: pd.DataFrame, file: Path, search: Search, make_env: MakeEnv
) -> pd.DataFrame:
    """Search the crashes; one row each, which the file keeps.

    Added columns: contact [s], last: the last moment from which it can be avoided [s], missing if there is none in the
    last seconds of BEFORE; avoided_by: the actions then, a digit each; clear: how long they are followed [s], less than
    SAFE where the episode ends before; contacts: in all searches.
    """
    stored = {(row["cell"], row["traffic"], row["scenario"]): row for row in crashes.to_dict("records")}
    envs: dict[str, gym.Env[Any, Any]] = {}  # by what they are made of

    def judge(wanted: Mapping[str, Any]) -> dict[str, Any] | None:
        place = wanted["cell"], wanted["traffic"], wanted["scenario"]
        row = {name: value for name, value in stored[place].items() if name in COLUMNS}
        path, record = results.directory / "cells" / place[0], results.cells[place[0]]
        made_of = [record["key"][part] for part in ("backend", "task", "env_config")]
        if (known := canonical_json(made_of)) not in envs:
            envs[known] = make_env(*made_of)
        try:
            with closing(Rewound(path, record, row, envs[known], BEFORE[-1])) as crash:
                moments = list(crash.moments(search, BEFORE[-1]))
        except UserError as error:
            print(f"skipped: {error}", file=sys.stderr)
            return None
        found = moments[-1] if moments and moments[-1].actions is not None else None
        return {
            "contact": crash.contact,
            "last": found.time if found else None,
            "avoided_by": "".join(map(str, found.actions or ())) if found else "",
            "clear": len(found.actions or ()) / crash.frequency if found else None,
            "contacts": sum(moment.contacts for moment in moments),
        }

    keys = ["cell", *GROUP, "seed", "traffic", "scenario"]
    rows = crashes[keys].astype({"seed": int}).to_dict("records")
    try:
        return fill(file, [{**row, "horizon": search.horizon} for row in rows], judge)
    finally:
        for env in envs.values():
            env.close()


def shares(table: pd.DataFrame) -> pd.DataFrame:
    """One row a setting and arm: agents, crashes, and the share that can be avoided so long before the contact.

    With Wilson's 95 % intervals over crashes: they hold for these agents, and are too narrow for others of their arm.
    until_end: how many of the crashes are avoided only up to the end of the episode, and not for SAFE seconds.
    """
    import pandas as pd

    rows = []
    for group, crashes in table.groupby(GROUP):
        margin = crashes["contact"] - crashes["last"]  # NaN where nothing was found
        row = {
            **dict(zip(GROUP, group, strict=True)),
            "agents": crashes["cell"].nunique(),
            "crashes": len(crashes),
        }
        row |= {f"{before:g} s": share(margin <= before).strip() for before in BEFORE}
        rows.append({**row, "until_end": int((crashes["clear"] < SAFE).sum())})
    return pd.DataFrame(rows).set_index(GROUP)
