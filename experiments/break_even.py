"""Say from which rate of risk events on treated agents crash less than control agents.

    python experiments/break_even.py
    python experiments/break_even.py --tasks u-turn --rates 1e-5:1 --episodes 10000

Drives the published agents of both arms in the lightest setting of each task, as `rare.py` drives one: all training
seeds, each in scenarios of its own. Rates are in units of the events at dose 1. Writes break-even.csv (both curves and
their difference, with 95 % intervals over agents and episodes), agents.csv (the curve of each agent), break-even.json
and break-even.svg. The report of the folder around the results shows the figure. The same command run again goes on
where it was stopped. docs/rare.md says what the columns mean.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated

import pandas as pd
import tyro

from agents import pretrained
from agents.files import DamagedFile
from experiments import rare
from experiments.analysis.break_even import CONTROL, TREATMENT, BreakEven, break_even, compared
from experiments.reporting.rare import BREAK_EVEN, break_even_figure, break_even_words
from experiments.study.design.options import TASK, Names
from experiments.study.design.sheet import GRID
from experiments.support.arguments import command
from experiments.support.errors import UserError, check_known, in_words, writing
from experiments.support.files import plain_json, read_json, write_file, write_json
from experiments.support.provenance import provenance
from sumo_env.tasks import TASKS


@dataclass(frozen=True, kw_only=True)
class Options(rare.Driving):
    """Say from which rate of risk events on treated agents crash less than control agents."""

    tasks: Annotated[Names, TASK] = None
    episodes: int = 2000
    """Episodes for the curve of an agent, about."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/study") / BREAK_EVEN
    """Directory for the results."""


def published(tasks: Sequence[str]) -> dict[str, dict[str, list[str]]]:
    """The published agents of the lightest setting, by task and arm. Raises UserError for fewer than two of an arm."""
    found: dict[str, dict[str, list[str]]] = {}
    check_known("task", tasks, TASKS)
    with in_words((FileNotFoundError, DamagedFile)):
        names = list(pretrained.cards())
    for task in tasks:
        setting = f"{task}-{next(iter(TASKS[task].levels))}"
        arms = {
            arm: [name for name in names if name.startswith(f"{setting}/{arm}")]
            for arm in (CONTROL, TREATMENT)
        }
        for arm, own in arms.items():
            if len(own) < 2:
                raise UserError(
                    f"an interval needs two agents {setting}/{arm} in {pretrained.FILE}, not {len(own)}"
                )
        found[task] = arms
    return found


def curve(options: Options, task: str, agent: str, number: int) -> pd.DataFrame:
    """The curve of one agent, in scenarios of this number; it is driven unless it is there."""
    out = options.out / agent.replace("/", "-")
    same = {field.name: getattr(options, field.name) for field in fields(rare.Driving)}
    asked = rare.Options(agent, task, episodes=options.episodes, seed=number, out=out, **same)
    rare.rare(asked, ["(by break_even.py)"])
    return pd.DataFrame(read_json(out / "curve.json")["curve"])


def run(options: Options, arguments: Sequence[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    asked = published(options.tasks or list(GRID))
    rates = rare.rates_of(options.rates)
    tables: dict[str, pd.DataFrame] = {}
    answers: dict[str, BreakEven] = {}
    agents: dict[str, pd.DataFrame] = {}
    with writing(options.out):
        for task, arms in asked.items():
            curves = {
                arm: [curve(options, task, agent, number) for number, agent in enumerate(own)]
                for arm, own in arms.items()
            }
            for arm, own in arms.items():
                agents |= dict(zip(own, curves[arm], strict=True))
            both = compared(curves)
            answers[task] = break_even(both)
            way = compared(curves, "100_km").add_suffix("_per_100_km")
            unclaimed = {
                f"{arm}_unclaimed": sum(
                    one.set_index("rate")["claim"].eq("nothing").astype(int) for one in own
                )
                for arm, own in curves.items()
            }
            table = pd.concat(
                [both.add_suffix("_per_episode"), way, pd.DataFrame(unclaimed)], axis=1
            ).reset_index()
            table.insert(1, "events_per_hour", curves[CONTROL][0]["events_per_hour"])
            tables[task] = table
        whole = pd.concat(tables, names=["task"]).reset_index(level=0)
        hours = {
            task: float(table["events_per_hour"].iloc[0] / table["rate"].iloc[0])
            for task, table in tables.items()
        }
        words = {task: break_even_words(answer, hours[task], rates) for task, answer in answers.items()}
        each = pd.concat(agents, names=["agent"]).reset_index(level=0)
        write_file(options.out / "agents.csv", each.to_csv(index=False, float_format="%.6g").encode())
        write_file(options.out / f"{BREAK_EVEN}.csv", whole.to_csv(index=False, float_format="%.6g").encode())
        write_file(options.out / f"{BREAK_EVEN}.svg", break_even_figure(whole).encode())
        write_json(
            options.out / f"{BREAK_EVEN}.json",
            {
                "command": shlex.join(["python", "experiments/break_even.py", *arguments]),
                "agents": asked,
                "events_per_hour_at_rate_1": hours,
                "break_even": {task: plain_json(answer._asdict()) for task, answer in answers.items()},
                "words": words,
                "provenance": provenance(),
            },
        )
    for task, said in words.items():
        print(f"{task}: {said}")
    print(f"written: {options.out / BREAK_EVEN}.csv, .json and .svg, and agents.csv")
    return 0


if __name__ == "__main__":
    command(lambda options: run(options, sys.argv[1:]), Options, __doc__, resumes=True)
