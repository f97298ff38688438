"""Say how the agents of a directory drive at risk 0 and at risk 1, and how others drive in the same scenarios.

    python experiments/test.py results/mine

The others are two agents of the published study, one trained in each traffic, and policies that do not learn. Crash
rate, return and speed [m/s] have 95 % intervals over scenarios. They hold for these agents: what a way of training does
needs several seeds (experiments/sweep.py).
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from operator import itemgetter
from typing import Annotated, Any

import pandas as pd
import tyro

from experiments.backends import make_env
from experiments.study import grid
from experiments.study.arms import TRAFFICS
from experiments.study.cell import CellTask
from experiments.study.evaluate import share
from experiments.study.store import EPISODES, Store
from experiments.support.errors import run_command

Z = 1.96  # normal quantile of a 95 % interval
PUBLISHED = Path(__file__).resolve().parents[1] / "results" / "standard"  # its lightest settings have weights


@dataclass(frozen=True)
class Options:
    """Say how the agents of a directory drive at risk 0 and at risk 1, and how others drive in the same scenarios."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Directory of train.py or sweep.py."""


def mean(values: pd.Series) -> str:
    """A mean with its interval."""
    half = Z * float(values.std()) / math.sqrt(len(values))
    return f"{values.mean():6.2f} ± {half:.2f}"


def test(options: Options) -> int:
    """Do what the options ask for; returns the exit status.

    Raises:
        UserError: there is no agent.
    """
    directory = options.directory
    agents = [record["key"] for record in Store(directory).agents().values()]
    others = missing(directory, agents)
    for number, task in enumerate(others, start=1):
        print(f"\rtesting {task.cell.policy} ({number} of {len(others)})   ", end="", flush=True)
        task.compute(lambda _: None)
    print("\r" + " " * 40 + "\r", end="")
    for setting in sorted({grid.setting(key) for key in agents}):
        print(table_of(setting, groups_of(directory, setting)))
    print("control: trained at risk 0; treatment: at risk 1. Intervals: 95 %, over scenarios.")
    print("Comparing ways of training needs several seeds: experiments/sweep.py")
    return 0


def missing(directory: Path, agents: Iterable[Mapping[str, Any]]) -> list[CellTask]:
    """The policies that do not learn, in the agents' settings, that are not tested yet."""
    names = {field.name for field in fields(grid.Cell)}
    wanted: dict[str, grid.Cell] = {}
    for key in agents:
        agent = grid.Cell(**{name: value for name, value in key.items() if name in names})
        profile = {"preset": agent.profile["preset"]}
        rule = replace(agent, kind="baseline", arm=None, seed=None, profile=profile, trained_with=None)
        wanted |= {cell.name: cell for policy in grid.BASELINES for cell in [replace(rule, policy=policy)]}
    there = set(Store(directory).finished())
    return [CellTask(cell, directory, make_env) for name, cell in wanted.items() if name not in there]


Rows = list[tuple[str, pd.DataFrame]]  # name of an agent or policy, and its test episodes


def groups_of(directory: Path, setting: str) -> dict[str, Rows]:
    """What is compared in a setting, in the scenarios that all have driven."""
    here, published = Store(directory), Store(PUBLISHED)
    keys = {name: record["key"] for name, record in here.records().items()}
    keys = {name: key for name, key in keys.items() if grid.setting(key) == setting}
    traffics = [[key["dynamics"], key["env_config"]] for key in keys.values()]
    theirs = {name: record["key"] for name, record in published.records().items()}
    groups = {
        "agents in this directory": [row_of(here, name) for name in keys if keys[name]["kind"] == "agent"],
        "agents of results/standard": [
            row_of(published, name)
            for name, key in theirs.items()
            if (key["kind"], grid.setting(key)) == ("agent", setting)
            and [key["dynamics"], key["env_config"]] in traffics
            and published.weights(name)
        ],
        "policies that do not learn": [
            row_of(here, name) for name in keys if keys[name]["kind"] == "baseline"
        ],
    }
    common = set.intersection(*(set(table["scenario"]) for rows in groups.values() for _, table in rows))
    return {
        title: sorted(
            ((name, table[table["scenario"].isin(common)]) for name, table in rows), key=itemgetter(0)
        )
        for title, rows in groups.items()
    }


def row_of(store: Store, name: str) -> tuple[str, pd.DataFrame]:
    """The name of a cell within its setting, and its test episodes."""
    key = store.record(name)["key"]
    label = grid.slug(key).removeprefix(f"{grid.setting(key)}-")
    return label, store.tables(name)[EPISODES]


def table_of(setting: str, groups: Mapping[str, Rows]) -> str:
    """The table of a setting."""
    scenarios = {table["scenario"].nunique() for rows in groups.values() for _, table in rows}
    lines = [
        f"{setting}: {max(scenarios)} scenarios at each risk, the same in every row",
        f"{'':<26}{'crash rate':^30}{'return':^34}{'speed [m/s]':^34}".rstrip(),
        f"{'':<26}{'risk 0':<15}{'risk 1':<15}" + f"{'risk 0':<17}{'risk 1':<17}" * 2,
    ]
    for title, rows in groups.items():
        lines.append(f"{title}:" if rows else f"{title}: none in this setting and traffic")
        for name, table in rows:
            by = [table[table["traffic"] == traffic] for traffic in TRAFFICS]
            cells = [f"{share(part['crashed']):<15}" for part in by]
            cells += [f"{mean(part[column]):<17}" for column in ("return", "mean_speed") for part in by]
            lines.append(f"  {name:<24}{''.join(cells)}".rstrip())
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    run_command(lambda: test(tyro.cli(Options, description=__doc__)))
