"""Say how agents drive at risk 0 and at risk 1, beside constant policies and rules.

    python experiments/test.py results/mine

Crash rate, return and speed [m/s] over the test scenarios, which are the same for all, with 95 % intervals over
scenarios. They hold for these agents: what a way of training does needs several seeds (experiments/sweep.py).
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])

from experiments.support.threads import limit_threads

limit_threads()

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import pandas as pd
import tyro

from experiments.backends import make_env
from experiments.study import grid, store
from experiments.study.arms import TRAFFICS
from experiments.study.cell import CellTask
from experiments.support.errors import UserError, run_command

Z = 1.96  # normal quantile of a 95 % interval


@dataclass(frozen=True)
class Options:
    """Say how agents drive at risk 0 and at risk 1, beside constant policies and rules."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Directory of train.py or sweep.py."""


def rate(crashed: pd.Series) -> str:
    """A crash rate in per cent with Wilson's interval."""
    n, p = len(crashed), float(crashed.mean())
    middle, half = (p + Z**2 / (2 * n)), Z * math.sqrt(p * (1 - p) / n + Z**2 / (4 * n**2))
    low, high = ((middle + sign * half) / (1 + Z**2 / n) for sign in (-1, 1))
    return f"{p:4.0%} [{100 * low:.0f}, {100 * high:.0f}]"


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
    records = {name: store.read_stored(directory, name) for name in store.finished(directory)}
    agents = {name: r["key"] for name, r in records.items() if r["key"]["kind"] == "agent"}
    if not agents:
        raise UserError(
            f"there is no trained agent in {directory}: python experiments/train.py --out {directory}"
        )
    others = missing(directory, agents)
    for number, task in enumerate(others, start=1):
        print(f"\rtesting {task.cell.policy} ({number} of {len(others)})   ", end="", flush=True)
        task.compute(lambda _: None)
    print("\r" + " " * 40 + "\r", end="")
    settings = sorted({grid.setting(key) for key in agents.values()})
    for setting in settings:
        show(directory, setting)
    print("95 % intervals over scenarios, the same for all; comparing ways of training needs several seeds")
    return 0


def missing(directory: Path, agents: Mapping[str, Mapping[str, Any]]) -> list[CellTask]:
    """The constant policies and rules in the agents' settings that are not tested yet."""
    names = {field.name for field in fields(grid.Cell)}
    wanted: dict[str, grid.Cell] = {}
    for key in agents.values():
        agent = grid.Cell(**{name: value for name, value in key.items() if name in names})
        profile = {"preset": agent.profile["preset"]}
        rule = replace(agent, kind="baseline", arm=None, seed=None, profile=profile, trained_with=None)
        wanted |= {cell.name: cell for policy in grid.BASELINES for cell in [replace(rule, policy=policy)]}
    there = set(store.finished(directory))
    return [CellTask(cell, directory, make_env) for name, cell in wanted.items() if name not in there]


def show(directory: Path, setting: str) -> None:
    """Print the table of a setting."""
    print(f"{setting:<26}{'crash rate':^30}{'return':^34}{'speed [m/s]':^34}")
    print(" " * 26 + f"{'risk 0':<15}{'risk 1':<15}" + f"{'risk 0':<17}{'risk 1':<17}" * 2)
    rows = []
    for name in store.finished(directory):
        key = store.read_stored(directory, name)["key"]
        if grid.setting(key) == setting and key["kind"] in ("agent", "baseline"):
            table = store.tables_of(directory, name)[store.EPISODES]
            by = [table[table["traffic"] == traffic] for traffic in TRAFFICS]
            cells = [f"{rate(part['crashed']):<15}" for part in by]
            cells += [f"{mean(part[column]):<17}" for column in ("return", "mean_speed") for part in by]
            rows.append((key["kind"] != "agent", grid.slug(key).removeprefix(f"{setting}-"), "".join(cells)))
    for _, label, text in sorted(rows):
        print(f"{label:<26}{text}".rstrip())
    print()


if __name__ == "__main__":
    run_command(lambda: test(tyro.cli(Options, description=__doc__)))
