"""Say how the agents of a directory drive at risk 0 and at risk 1, and how others drive in the same scenarios.

    python experiments/test.py results/mine

The others are two agents of the published study, one trained in each traffic, and policies that do not learn. Crash
rate, return and speed [m/s] have 95 % intervals over scenarios. They hold for these agents only.
To compare ways of training, train with several seeds (experiments/sweep.py).
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import pandas as pd
import tyro

from experiments.study.compute.evaluate import driving
from experiments.study.design import grid
from experiments.study.design.traffic import ALL, TRAFFICS
from experiments.study.results.store import EPISODES, Store
from experiments.support.arguments import command
from experiments.support.errors import UserError

SHOWN = {"crash rate": "crash_rate", "return": "return", "speed [m/s]": "speed"}
LEGEND = """\
control, treatment    agents trained at risk 0 and at risk 1; published: of results/standard
careful               a rule that gets as far as it can without coming close to others
idm                   a rule: IDM for the speed, MOBIL for the lane
idle, slower, faster  one action, always; an agent that is only as safe as slower should drive faster than it
random                any action

Intervals: 95 %, over scenarios. Comparing ways of training needs several seeds: experiments/sweep.py"""
PUBLISHED = Path(__file__).resolve().parents[1] / "results" / "standard"  # its lightest settings have weights


@dataclass(frozen=True)
class Options:
    """Say how the agents of a directory drive at risk 0 and at risk 1, and how others drive in the same scenarios."""

    directory: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]
    """Directory of train.py or sweep.py."""


def words(name: str, value: float, low: float, high: float) -> str:
    """A number of `driving` with its interval: " 10% [4, 21]"."""
    if name == "crash_rate":
        return f"{value:4.0%} [{100 * low:.0f}, {100 * high:.0f}]"
    return f"{value:6.2f} ± {high - value:.2f}"


def test(options: Options) -> int:
    """Do what the options ask for; returns the exit status."""
    directory = options.directory
    agents = [record["key"] for record in Store(directory).agents().values()]
    for setting in sorted({grid.setting(key) for key in agents}):
        table, scenarios = compared(directory, setting)
        print(f"{setting}: {scenarios} scenarios at each risk, the same in every row\n")
        print(table.map("{:<14}".format).to_string(justify="left"), end="\n\n")
    print(LEGEND)
    return 0


def compared(directory: Path, setting: str) -> tuple[pd.DataFrame, int]:
    """What a setting's agents and policies do in the scenarios that all have driven, and the number of these."""
    here, study = Store(directory), Store(PUBLISHED)
    records = sorted(here.records().items(), key=lambda item: item[1]["key"]["kind"])  # agents first
    own = {name: record["key"] for name, record in records}
    own = {name: key for name, key in own.items() if grid.setting(key) == setting and key["kind"] != "test"}
    alike = [driven_in(key) for key in own.values()]
    slugs = Counter(grid.slug(key) for key in own.values())
    rows = [  # trainings that differ by their settings alone are told apart by the hash of their names
        (name if slugs[grid.slug(key)] > 1 else grid.slug(key), here.tables(name)[EPISODES])
        for name, key in own.items()
    ]
    common = set.intersection(*(set(table["scenario"]) for _, table in rows))
    for name, record in study.records().items():  # none where the published results are not here
        if record["key"]["kind"] == "agent" and driven_in(record["key"]) in alike and study.weights(name):
            table = study.tables(name)[EPISODES]
            if met := common & set(table["scenario"]):  # the second study has others
                rows.append((f"{grid.slug(record['key'])} (published)", table))
                common = met
    if not common:
        raise UserError(f"{setting} in {directory}: its agents were tested in different scenarios")
    found = {}
    for number, (label, table) in enumerate(rows):
        parts = table[table["scenario"].isin(common)].groupby("traffic")
        numbers = {traffic: driving(parts.get_group(traffic)) for traffic in TRAFFICS}
        found[number, label.removeprefix(f"{setting}-")] = {
            (title, f"risk {ALL[traffic].dose:g}"): words(name, *numbers[traffic][name])
            for title, name in SHOWN.items()
            for traffic in TRAFFICS
        }
    return pd.DataFrame.from_dict(found, orient="index").droplevel(0), len(common)


def driven_in(key: Mapping[str, Any]) -> list[Any]:
    """What two tests have to have in common to be compared."""
    return [grid.setting(key), key["dynamics"], key["env_config"]]


if __name__ == "__main__":
    command(test, Options, __doc__)
