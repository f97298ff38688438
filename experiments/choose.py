"""Say which of several learners drives best, by the rule of docs/developers/learner_choice.md.

    python experiments/choose.py results/choice/tuned results/choice/columns results/choice/three-steps

A folder is a candidate; in it lie folders of sweeps, of the same names in all. Every agent is scored in the traffic of
its training: 0 is the return of the best constant action, 1 that of the best driver of all candidates' folders, agents
and drivers of fixed rules, on the same scenarios. Rules may drive in one candidate's folders alone.
"""

from __future__ import annotations

import sys
from pathlib import Path

if __package__ in (None, ""):  # run as a file: import from the project, not from this folder
    sys.path[0] = str(Path(__file__).resolve().parents[1])
    import experiments.support.needs  # noqa: F401  (says what has to be installed)

from dataclasses import dataclass
from typing import Annotated

import pandas as pd
import tyro

from experiments.analysis.gates import gates
from experiments.study.design.arms import ARMS, gate_traffics
from experiments.study.design.cell import setting_of_agent
from experiments.study.results.loaded import SETTING, load
from experiments.study.results.store import Store
from experiments.support.arguments import command
from experiments.support.errors import UserError
from experiments.support.files import write_file

CONSTANT = ("idle", "faster", "slower")
PLACE = ["sweep", *SETTING, "traffic"]  # where returns are compared
AGENT = ["candidate", "arm", "seed"]
COLUMNS = [*PLACE, *AGENT, "policy", "return", "crashed", "speed", "cpu", "failed"]


@dataclass(frozen=True)
class Options:
    """Say which of several learners drives best."""

    candidates: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="DIR ...")] = ()
    """A folder of each candidate, with folders of sweeps."""
    table: Annotated[Path | None, tyro.conf.arg(metavar="FILE.csv")] = None
    """How everybody drives in finished settings: read, and written with those that the folders add."""


def drivers(candidate: Path) -> pd.DataFrame:
    """How everybody drives who has a cell in a candidate's folder.

    Returns:
        A row a driver and traffic (of an agent that of its training): COLUMNS, return, crashed and speed [m/s]; of an
        agent also cpu of its training [s], and failed, its gates. Sweeps that lack agents are named and left out.

    Raises:
        UserError: no sweep.
    """
    found = []
    for folder in sorted(path for path in candidate.iterdir() if path.is_dir()):
        if not Store(folder).finished():
            print(f"{folder} has no agent yet, and does not count")
            continue
        results = load(folder)
        if missing := sorted(
            name for name in results.expected if name not in results.cells and setting_of_agent(name)
        ):
            print(f"{folder} has not all its agents ({missing[0]}), and does not count: run its sweep again")
            continue
        tests = results.episodes.groupby(["cell", "traffic"])[["return", "crashed", "mean_speed"]].mean()
        rows = tests.reset_index().merge(results.table.reset_index(drop=True), on="cell")
        of_training = [
            arm not in ARMS or traffic in gate_traffics(arm)
            for arm, traffic in zip(rows["arm"], rows["traffic"], strict=True)
        ]
        cpu = {name: cell["timing"].get("train_cpu_seconds") for name, cell in results.cells.items()}
        failed = gates(results.cells, results.gate_episodes).set_index("cell")["failed"]
        told = pd.DataFrame({"cpu": cpu, "failed": failed})
        rows = rows[of_training].join(told, on="cell")
        rows = rows.assign(candidate=candidate.name, sweep=folder.name).rename(
            columns={"mean_speed": "speed"}
        )
        found.append(rows[COLUMNS])
    if not any(candidate.iterdir()):
        raise UserError(f"{candidate} has no folder of a sweep")
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame(columns=COLUMNS)


def whole(found: pd.DataFrame) -> pd.DataFrame:
    """The rows of sweeps in which all candidates have agents."""
    agents = found[found["arm"].isin(ARMS)]
    there = agents.groupby("sweep")["candidate"].nunique() == agents["candidate"].nunique()
    return found[found["sweep"].isin(there.index[there])]


def scored(found: pd.DataFrame) -> pd.DataFrame:
    """The agents among drivers of all candidates, with their score.

    Raises:
        UserError: a candidate lacks agents of others, or nobody drives better than a constant action.
    """
    agents = found[found["arm"].isin(ARMS)]
    low = found[found["policy"].isin(CONSTANT)].groupby(PLACE)["return"].max()
    high = found.groupby(PLACE)["return"].max()
    places = pd.MultiIndex.from_frame(agents[PLACE])
    zero, one = low.reindex(places).to_numpy(), high.reindex(places).to_numpy()
    for _, flat in agents[one <= zero].iterrows():
        raise UserError(
            f"a constant action is the best driver of {flat['task']} {flat['level_name']} in {flat['traffic']} "
            "traffic: leave the setting out"
        )
    agents = agents.assign(score=(agents["return"] - zero) / (one - zero))
    counts = agents.groupby(["candidate", "sweep", *SETTING, "arm"]).size().unstack("candidate")
    if counts.nunique(axis=1).max() != 1 or counts.isna().to_numpy().any():
        raise UserError(f"the candidates have not the same agents:\n{counts}")
    return agents


def chosen(agents: pd.DataFrame) -> pd.DataFrame:
    """A row a candidate, the best first: score, the mean over settings, agents alike within one; cpu [s] likewise;
    crashed; gates, the share of agents that fail none; diverged, how many do.
    """
    by_setting = agents.groupby(["candidate", "sweep", *SETTING])[["score", "cpu", "crashed"]].mean()
    table = by_setting.groupby("candidate").mean()
    failed = agents["failed"].fillna("")
    table["gates"] = (failed == "").groupby(agents["candidate"]).mean()
    table["diverged"] = failed.str.contains("q_bounded").groupby(agents["candidate"]).sum()
    return table.sort_values("score", ascending=False)


def main(options: Options) -> int:
    """Print the agents and the candidates; returns the exit status."""
    folders = [rows for rows in map(drivers, options.candidates) if len(rows)]
    found = whole(pd.concat(folders)) if folders else pd.DataFrame(columns=COLUMNS)
    if options.table:
        if options.table.exists():
            before = pd.read_csv(options.table, dtype={"level_name": str, "arm": str, "failed": str})
            before = before[~before["sweep"].isin(found["sweep"])]
            found = pd.concat([rows for rows in (before, found) if len(rows)])
        found = found.sort_values(["sweep", "candidate", "traffic", "policy", "arm", "seed"])
        write_file(options.table, found.to_csv(index=False, float_format="%.6g").encode())
    agents = scored(found.reset_index(drop=True)).astype({"seed": int})
    print(f"{agents['sweep'].nunique()} settings")
    shown = ["sweep", "task", "level_name", *AGENT, "score", "return", "crashed", "speed", "cpu", "failed"]
    with pd.option_context("display.width", 200, "display.precision", 3):
        print(agents[shown].sort_values(shown[:6]).to_string(index=False))
        print(chosen(agents).to_string())
    return 0


if __name__ == "__main__":
    command(main, Options, __doc__)
