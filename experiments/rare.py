"""Say how often policies crash where risk events are as rare as on a road, down to once in a million episodes.

    python experiments/rare.py careful-4 --task u-turn --rates 1e-4:1
    python experiments/rare.py u-turn-3/control u-turn-3/treatment --task u-turn --episodes 20000 --out results/rare
    python experiments/rare.py my_policy.py:make --task highway --rates 0.01 --plain          # counts, to compare

Rates are in units of the events at dose 1 (docs/traffic-and-risk.md); the other drivers' parameters stay those of
--dose. Events near the ego are drawn more often than they are asked about, and every episode counts by its exact
weight; how much more often is chosen by a pilot. Crashes without an event near the ego are as rare as they are: they
have a limit of their own. Where too few crashes carry an estimate, the table says that nothing is claimed.

Writes curve.json, curve.csv and curve.svg, of all policies. The same command run again goes on where it was stopped;
finished batches of episodes are never driven twice. docs/rare.md says what the columns mean, and what to beware of.
"""

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
import pandas as pd
import tyro

from experiments.analysis import rare as analysis
from experiments.backends import make_env
from experiments.reporting.rare import rare_figure
from experiments.study.compute.batches import driven
from experiments.study.compute.entrants import entrant_of
from experiments.study.compute.executors import EXECUTORS
from experiments.study.compute.rare import Batch, Question
from experiments.study.design.fingerprint import check_dynamics, dynamics
from experiments.study.design.levels import TaskName, level_names, tasks_known
from experiments.study.design.sheet import task_of
from experiments.support.arguments import as_typed, command
from experiments.support.errors import UserError, check_known, check_least, writing
from experiments.support.files import write_file, write_json
from experiments.support.provenance import provenance

BATCH = 100  # episodes, about
PILOT = 100  # episodes, which do not count for the curve
SHOWN = {
    "rate": "rate",
    "events_per_hour": "per vehicle-hour",
    "crashes_per_episode": "crashes/episode",
    "by_events_per_episode": "by events",
    "crashes_per_100_km": "per 100 km",
}


@dataclass(frozen=True)
class Options:
    """Say how often policies crash where risk events are as rare as on a road."""

    policies: Annotated[
        tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="POLICY ...", help_behavior_hint="")
    ]
    """Published agents (treatment, u-turn-3/treatment), zip files of Stable-Baselines3, FILE:MAKE, directories of
    results, or drivers of fixed rules (careful-4)."""
    task: TaskName
    """Task that is driven."""
    level: str = ""
    """Its traffic level by name (of u-turn 3, 6, 9 or 12), not by number; by default the lightest."""
    rates: str = "1e-4:1"
    """Rates of events, 1 for those at dose 1: LOW:HIGH (two in each decade), or some with commas between."""
    episodes: int = 5000
    """Episodes for the curve of a policy, about."""
    dose: float = 0.001
    """Dose of risk that the other drivers' parameters have, above 0 (0.001: regular drivers)."""
    reach: float = 40.0
    """Events of vehicles within so many metres of the ego come more often."""
    plain: bool = False
    """Count plainly: events come no more often than asked about."""
    seed: int = 0
    """Of all scenarios."""
    executor: str = "local"
    """Where episodes are driven: local (processes of this machine), ray or slurm (docs/clusters.md)."""
    workers: int | None = None
    """Batches at a time; by default one for each core."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/rare")
    """Directory for the results, whose curves are written anew."""


def rates_of(text: str) -> tuple[float, ...]:
    """The rates that an option names, rising. Raises UserError."""
    try:
        numbers = [float(word) for word in text.replace(":", ",").split(",")]
    except ValueError:
        numbers = []
    if not numbers or not all(1e-9 <= one <= 1.0 for one in numbers) or (":" in text and len(numbers) != 2):
        raise UserError(f"--rates are LOW:HIGH, or numbers with commas between, from 1e-9 to 1, not {text!r}")
    if ":" in text:
        low, high = sorted(numbers)
        steps = max(round(2 * math.log10(high / low)), 1)
        numbers = [float(f"{one:.3g}") for one in np.geomspace(low, high, steps + 1)]
    return tuple(sorted(set(numbers)))


def question(options: Options, policy: str) -> Question:
    """What the options ask of a policy. Raises UserError for what does not exist or makes no sense, before anything is
    driven.
    """
    check_known("task", [options.task], tasks_known())
    levels = level_names(options.task)
    level = options.level or levels[0]
    check_known("level", [level], levels)
    check_known("executor", [options.executor], EXECUTORS)
    check_least(options, episodes=1, seed=0, workers=1)
    if not 0.001 <= options.dose <= 1.0:
        raise UserError(f"--dose is between 0.001 and 1, not {options.dose}")
    if not options.reach > 0.0:
        raise UserError(f"--reach is above 0, not {options.reach}")
    entrant = entrant_of(policy, options.task, level)
    own = options.dose, options.reach, options.seed, dynamics("sumo", task_of(options.task))
    found = Question(entrant, options.task, level, *own)
    with closing(make_env("sumo", task_of(found.task), found.config)) as env:
        return replace(found, driver=entrant.resolved(env))


def drive(
    options: Options, asked: Question, part: str, components: Sequence[tuple[float, float]], episodes: int
) -> pd.DataFrame:
    """Episodes of these components, those included that were driven before. Raises UserError where some failed."""
    rounds = max(BATCH // len(components), 1)
    count = -(-episodes // (rounds * len(components)))
    batches = [Batch(options.out, asked, part, tuple(components), rounds, k) for k in range(count)]
    return driven(batches, options.executor, options.workers, f"batches ({part})")


def curve_of(
    options: Options, asked: Question, rates: Sequence[float]
) -> tuple[pd.DataFrame, dict[str, Any]]:
    """The curve of a policy, with the columns of `analysis.curve`, and what is stored of it."""
    levels: tuple[float, ...] = ()
    if not options.plain:
        levels = analysis.choose(drive(options, asked, "pilot", [(rates[0], rates[0])], PILOT))
        print(f"events near the ego come as often as at the rates {' and '.join(map(str, levels))}")
    higher = {rate: [level for level in levels if level > rate] for rate in rates}
    components = [(rate, level) for rate in rates for level in (rate, *higher[rate])]
    episodes = drive(options, asked, "curve", components, options.episodes)
    curve = analysis.curve(episodes, rates)
    curve.insert(1, "events_per_hour", 3600.0 * sum(asked.rates.values()) * curve["rate"])
    stored = {
        "question": asked.key,
        "levels": levels,
        "episodes": len(episodes),
        "steps": int(episodes["steps"].sum()),
        "curve": curve.to_dict("records"),
    }
    return curve, stored


def rare(options: Options, arguments: Sequence[str]) -> int:
    """Do what the options ask for; returns the exit status."""
    rates, curves, stored = rates_of(options.rates), dict[str, pd.DataFrame](), dict[str, dict[str, Any]]()
    questions = {policy: question(options, policy) for policy in options.policies}
    check_dynamics([("sumo", task_of(options.task))])
    with writing(options.out):
        for policy, asked in questions.items():
            curves[policy], stored[policy] = curve_of(options, asked, rates)
            print(f"{policy}:\n{table(curves[policy]).to_string(index=False)}")
            without = f"crashes without an event near the ego: {limit(curves[policy])}"
            print(f"{stored[policy]['episodes']} episodes; intervals: 95 %; {without}", flush=True)
        whole = pd.concat(curves, names=["policy"]).reset_index(level=0)
        write_file(options.out / "curve.csv", whole.to_csv(index=False).encode())
        title = f"{asked.task} {asked.level}, drivers of dose {asked.dose:g}"
        write_file(options.out / "curve.svg", rare_figure(curves, title).encode())
        record = {"command": as_typed("rare", arguments), "policies": stored}
        write_json(options.out / "curve.json", {**record, "provenance": provenance()})
    print(f"written: {options.out / 'curve.json'}, curve.csv, curve.svg")
    return 0


def table(curve: pd.DataFrame) -> pd.DataFrame:
    """What is printed: estimates with their intervals, and what is claimed."""
    shown = pd.DataFrame()
    for name, title in SHOWN.items():
        shown[title] = curve[name].map("{:.2g}".format)
        if f"{name}_low" in curve:
            ends = zip(curve[f"{name}_low"], curve[f"{name}_high"], strict=True)
            shown[title] += [f" [{low:.1e}, {high:.1e}]" for low, high in ends]
    shown["crashes"] = curve["crashes_by_events"]
    shown["effective"] = curve["effective_crashes"].map("{:.0f}".format)
    shown["largest"] = curve["largest_share"].map("{:.0%}".format)
    shown["claimed"] = curve["claim"]
    return shown


def limit(curve: pd.DataFrame) -> str:
    """How often crashes happen without events, at the lowest rate, in words."""
    first = curve.iloc[0]
    if not first["crashes_without"]:
        return f"none seen, fewer than {first['without_per_episode_high']:.1e} an episode"
    low, high = first["without_per_episode_low"], first["without_per_episode_high"]
    return f"{first['without_per_episode']:.1e} [{low:.1e}, {high:.1e}] an episode"


if __name__ == "__main__":
    command(lambda options: rare(options, sys.argv[1:]), Options, __doc__, resumes=True)
