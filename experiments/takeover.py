"""Say which of two drivers gets into danger less often, and which one gets out of it: caution and skill.

    python experiments/takeover.py u-turn-3/control u-turn-3/treatment --task u-turn
    python experiments/takeover.py my_policy.py:make sumo --task highway --traffics risky    # SUMO's driver takes over
    python experiments/takeover.py results/mine/control results/mine/treatment --task roundabout   # all pairs in there

A crash rate mixes both: who keeps out of danger needs no skill. Here one driver leads until its first critical moment:
a copy of the episode that goes on with IDLE (target speed and lane stay) crashes within 3 s, so that the driver has to
act. From there both go on, each in a copy of its own: equal moments, equal speeds, the same future. Caution is how
often a leader gets into such moments; skill is who crashes within 5 s from them, the moments of both leaders counted.

A and B may be any policies of evaluate.py with the same observations and actions, IDLE among them. Several are named
with commas between, or as DIR/PART: the agents in a directory of results with PART in their names, by training seed;
A's first and B's first are a pair, and the interval is over pairs. With one pair it is over scenarios: it says
something of these two drivers, nothing of how they were trained. planner, clairvoyant and sumo only take over.

Writes takeover.json, takeover.csv, takeover.svg, moments.parquet (a row a pair, leader and scenario), and takeover.gif:
one moment with both endings. The same command run again goes on where it was stopped. docs/takeover.md explains all of
it.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Annotated, Any

import pandas as pd
import tyro

from experiments.analysis import takeover as analysis
from experiments.reporting.tables import chosen
from experiments.reporting.takeover import from_moments, table, takeover_figure
from experiments.study.compute.batches import driven
from experiments.study.compute.entrants import Entrant, entrant_of, several
from experiments.study.compute.executors import EXECUTORS
from experiments.study.compute.takeover import BOUNDS, COLUMNS, COSTLY, OTHERS, PAIR, WINDOW, Batch, Question
from experiments.study.design.arms import NUMBERED
from experiments.study.design.experiment import assignments
from experiments.study.design.fingerprint import check_dynamics, dynamics
from experiments.study.design.levels import TaskName, env_config, level_names, tasks_known
from experiments.study.design.sheet import task_of
from experiments.study.design.traffic import ALL, TRAFFICS
from experiments.study.replaying.takeover import films, most_telling
from experiments.study.results.parquet import write_part
from experiments.support.arguments import argument, as_typed, command
from experiments.support.errors import UserError, check_known, check_least, in_words, writing
from experiments.support.files import plain_json, write_file, write_json
from experiments.support.films import save_film, side_by_side
from experiments.support.provenance import provenance

BATCH = 10  # scenarios
AT = ["traffic", "within"]
WHEN = {"in_time": f"within {WINDOW:g} s", "later": "later", "sudden": "suddenly"}


@dataclass(frozen=True)
class Options:
    """Say which of two drivers gets into danger less often, and which one gets out of it."""

    a: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="A")]
    """A published agent (control, u-turn-3/control-s801), a zip file of Stable-Baselines3, FILE:MAKE, a directory of
    results or a driver of fixed rules (careful-4, idm, slower); several with commas between, or DIR/PART."""
    b: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="B")]
    """The same; of as many policies as A."""
    task: TaskName
    """Task that is driven."""
    level: str = ""
    """Its traffic level by name (of u-turn 3, 6, 9 or 12), not by number; by default the lightest."""
    config: Annotated[tuple[str, ...], argument("KEY=VALUE ...")] = ()
    """Keys of the environment's configuration that both were trained with (values as in JSON, or plain words); what
    stored agents observe is known."""
    traffics: tuple[str, ...] = TRAFFICS
    """Traffics by name (docs/traffic-and-risk.md), each answered by itself."""
    scenarios: int = 50
    """Test scenarios in each traffic."""
    first_scenario: int = 0
    """Number of the first one (those of the study, plan 6, begin at 8000)."""
    within: tuple[float, ...] = BOUNDS
    """A moment is critical where IDLE crashes within so many seconds; several are answered one after the other."""
    others: tuple[str, ...] = ("sumo", "slower", "random")
    """Who takes over from the same moments beside A and B: sumo, slower, random, planner (slow: first pair alone)."""
    executor: str = "local"
    """Where episodes are driven: local (processes of this machine), ray or slurm (docs/clusters.md)."""
    workers: int | None = None
    """Batches at a time; by default one for each core."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/takeover")
    """Directory for the results, whose answers are written anew."""


def called(options: Options) -> dict[str, str]:
    """What the two are called in tables, by their names in the record."""
    a, b = (Path(policies.partition(",")[0]).name for policies in (options.a, options.b))
    return dict(zip(PAIR, (a, b) if a != b else (f"{a} (A)", f"{b} (B)"), strict=True))


def check(options: Options) -> None:
    """Raise UserError for what does not exist or makes no sense."""
    check_known("task", [options.task], tasks_known())
    check_known("level", [options.level or level_names(options.task)[0]], level_names(options.task))
    check_known("traffic", options.traffics, ALL)
    check_known("driver of --others", options.others, OTHERS)
    check_known("executor", [options.executor], EXECUTORS)
    check_least(options, scenarios=1, workers=1)
    for name, is_right, least in (
        ("first-scenario", options.first_scenario in NUMBERED, f"from 0 to {NUMBERED[-1]}"),
        ("traffics", len({*options.traffics}) == len(options.traffics) > 0, "one or more, each once"),
        ("within", len({*options.within}) == len(options.within) > 0, "one or more bounds, each once"),
        ("within", min(options.within, default=0.0) > 0.0, "seconds above 0"),
    ):
        if not is_right:
            raise UserError(f"--{name} is {least}, not {getattr(options, name.replace('-', '_'))}")


def questions(options: Options) -> list[list[Question]]:
    """By pair and traffic what the options ask. Raises UserError where it cannot be asked, before all driving."""
    check(options)
    level = options.level or level_names(options.task)[0]
    a, b = (several(policies, options.task, level) for policies in (options.a, options.b))
    if len(a) != len(b):
        raise UserError(
            f"the first of A and the first of B are a pair: name as many of both, not {len(a)} and {len(b)}"
        )
    changes = observation_of([*a, *b]) | assignments(options.config, "--config", "policy_frequency=2")
    with in_words():
        config = env_config("sumo", options.task, level_names(options.task).index(level) + 1, changes)
    what = options.task, level, config
    does, found = dynamics("sumo", task_of(options.task)), list[list[Question]]()
    for pair in zip(a, b, strict=True):
        others = (name for name in options.others if not found or name not in COSTLY)
        drivers = dict(zip(PAIR, pair, strict=True)) | {
            name: entrant_of(name, options.task, level) for name in others
        }
        first = Question(*what, options.traffics[0], drivers, options.within, does)
        if not first.leaders:
            raise UserError(f"{pair[0].name} and {pair[1].name} only take over: one of the two has to lead")
        with closing(first.open()) as env:
            first = replace(first, drivers={name: one.resolved(env) for name, one in drivers.items()})
        found.append([replace(first, traffic=traffic) for traffic in options.traffics])
    check_dynamics([("sumo", task_of(options.task))])
    return found


def observation_of(drivers: Iterable[Entrant]) -> dict[str, Any]:
    """The configuration of what agents among them observe. Raises UserError where they observe different things."""
    known = [one for one in drivers if one.observation]
    for one in known[1:]:
        if one.observation != known[0].observation:
            raise UserError(
                f"{known[0].name} and {one.name} were trained with different observations, so that neither can be "
                "shown what the other one sees"
            )
    return known[0].config if known else {}


def drive(options: Options, asked: Sequence[Sequence[Question]]) -> pd.DataFrame:
    """The record, what was driven before included."""
    end = options.first_scenario + options.scenarios
    batches = [
        Batch(options.out, question, pair, first, min(BATCH, end - first))
        for pair, own in enumerate(asked)
        for question in own
        for first in range(options.first_scenario, end, BATCH)
    ]
    return driven(batches, options.executor, options.workers, "batches")


def film(
    options: Options, asked: Sequence[Sequence[Question]], rows: pd.DataFrame, names: Mapping[str, str]
) -> str:
    """Write the film of one moment in the last traffic; returns what it shows, in words."""
    row = most_telling(chosen(rows, traffic=options.traffics[-1], within=options.within[0]))
    if row is None:
        return "no film: there is no critical moment"
    both = films(asked[row["pair"]][-1], row, names)
    caption = [
        f"{names[row['leader']]} leads for {row['moment']:g} s. With IDLE it would crash within {row['within']:g} s.",
        f"Scenario {row['scenario']} in {row['traffic']} traffic, {row['task']} {row['level']}.",
    ]
    save_film(side_by_side(both, caption=caption), options.out / "takeover.gif")
    return f"takeover.gif, scenario {row['scenario']}: {'; '.join(title for title, _ in both)}"


def takeover(options: Options, arguments: Sequence[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    asked, names = questions(options), called(options)
    with writing(options.out):
        rows = drive(options, asked)
        write_part(options.out / "moments.parquet", "moments", COLUMNS, rows, {})
        of = {"answers": analysis.answers, "rates": analysis.rates, "own_crashes": analysis.own_crashes}
        frames = {name: analysis.each(rows, AT, analyse) for name, analyse in of.items()}
        by_question = frames["answers"].groupby(AT, sort=False)
        said = {at: analysis.claims(own, [*names.values()]) for at, own in by_question}
        found = {
            "command": as_typed("takeover", arguments),
            "scenarios": options.scenarios,
            "first_scenario": options.first_scenario,
            "questions": [question.key for own in asked for question in own],
            "claims": [dict(zip(AT, at, strict=True)) | claims for at, claims in said.items()],
            **{name: frame.to_dict("records") for name, frame in frames.items()},
            "provenance": provenance(),
        }
        write_json(options.out / "takeover.json", plain_json(found))
        write_file(options.out / "takeover.csv", frames["answers"].to_csv(index=False).encode())
        first, rates = (chosen(frames[name], within=options.within[0]) for name in ("answers", "rates"))
        figure = takeover_figure(first, rates, names, f"{options.task} {asked[0][0].level}")
        write_file(options.out / "takeover.svg", figure.encode())
        filmed = film(options, asked, rows, names)
    for at, own in by_question:
        print(f"\n{at[0]} traffic, IDLE crashes within {at[1]:g} s: ", end="")
        print("; ".join(f"{question}: {claim}" for question, claim in said[at].items()))
        print(table(own, names).to_string(index=False))
        crashes = from_moments(chosen(frames["rates"], traffic=at[0], within=at[1]), names)
        if len(crashes):
            print(f"crashes from the moments [%]:\n{crashes.to_string(index=False)}")
        for row in chosen(frames["own_crashes"], traffic=at[0], within=at[1]).to_dict("records"):
            shares = ", ".join(f"{word} {row[name]:.0%}" for name, word in WHEN.items() if row["crashes"])
            print(f"{row['crashes']} crashes of {names[row['leader']]}, leading{': ' * bool(shares)}{shares}")
    print(f"{filmed}\nwritten: {options.out / 'takeover.json'}, .csv, .svg and moments.parquet")
    return 0


if __name__ == "__main__":
    command(lambda options: takeover(options, sys.argv[1:]), Options, __doc__, resumes=True)
