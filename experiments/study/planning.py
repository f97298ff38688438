"""What planning in copies reaches: both planners on the agents' test scenarios, beside agents and careful driver.

    python -m experiments.study.planning      compute what results/copies/planners.parquet lacks, and print the table

The lightest level of each task. "planner" imagines the events to come, "clairvoyant" knows them: in regular traffic,
which has no events, they are one.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from agents.rules import PLANNERS, make_policy
from experiments.backends import make_env
from experiments.study.arms import ARMS, TRAFFICS
from experiments.study.evaluate import play
from experiments.study.grid import env_config
from experiments.support import limit_threads
from experiments.support.errors import run_command
from experiments.support.files import fill
from sumo_env.tasks import TASKS

if TYPE_CHECKING:
    import gymnasium as gym
    import pandas as pd

RESULTS = Path(__file__).resolve().parents[2] / "results"
FILE, STUDY = RESULTS / "copies" / "planners.parquet", RESULTS / "standard"
SCENARIOS = 50
KEPT = (
    "return",
    "length",
    "crashed",
    "arrived",
    "mean_speed",
    "distance",
    "crash_time",
    "crash_type",
    "actions",
)


def play_all(file: Path, scenarios: int) -> pd.DataFrame:
    """One row per task, traffic, planner and scenario; played if the file does not have it."""
    envs: dict[str, gym.Env[Any, Any]] = {}

    def episode(wanted: Mapping[str, Any]) -> dict[str, Any]:
        task = wanted["task"]
        if task not in envs:
            envs[task] = make_env("sumo", task, env_config("sumo", task, 1))
        policy = make_policy(wanted["policy"], envs[task])
        row = play(envs[task], policy, task, 1, wanted["traffic"], wanted["scenario"])
        return {name: row[name] for name in KEPT}

    wanted = [
        {"task": task, "traffic": traffic, "policy": policy, "scenario": scenario}
        for scenario in range(scenarios)
        for task in TASKS
        for traffic in TRAFFICS
        for policy in (PLANNERS if traffic == "risky" else ("clairvoyant",))
    ]
    try:
        return fill(file, wanted, episode)
    finally:
        for env in envs.values():
            env.close()


def study(scenarios: Collection[int]) -> pd.DataFrame:
    """The same scenarios of the published study, by its agents of both arms and the careful driver."""
    from experiments.study.store import load

    rows = load(STUDY).episodes
    met = rows["scenario"].isin(scenarios) & rows["traffic"].isin(list(TRAFFICS))
    rows = rows[met & (rows["level"] == 1)]
    rows = rows.assign(policy=rows["policy"].where(rows["kind"] == "baseline", rows["arm"]))
    return rows[rows["kind"].isin(["agent", "baseline"]) & rows["policy"].isin([*ARMS, "careful"])]


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Crash rate / return / distance per scheduled second [m/s]: one row a traffic and driver, one column a task."""
    seconds = rows["task"].map({task: env_config("sumo", task, 1)["duration"] for task in TASKS})
    values = rows.assign(pace=rows["distance"] / seconds)
    means = values.groupby(["traffic", "policy", "task"])[["crashed", "return", "pace"]].mean()
    text = means["crashed"].map("{:.2f}".format) + means["return"].map("/{:.1f}".format)
    return (text + means["pace"].map("/{:.1f}".format)).unstack("task")[list(TASKS)]


def main(out: Path = FILE, scenarios: int = SCENARIOS) -> int:
    """Drive the planners through the agents' test scenarios, and print how they do beside agents and careful driver.

    Args:
        out: table of the episodes; it goes on where it was stopped.
        scenarios: number of scenarios in each task and traffic.
    """
    import pandas as pd

    limit_threads()
    out.parent.mkdir(parents=True, exist_ok=True)
    planned = play_all(out, scenarios)
    print(summary(pd.concat([planned, study(range(scenarios))], ignore_index=True)).to_string())
    print("crash rate / return / distance per scheduled second [m/s]")
    return 0


if __name__ == "__main__":
    run_command(lambda: tyro.cli(main), resumes=True)
