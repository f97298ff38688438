"""How the belief should act: the pilot of the fourth plan, on scenarios that no test and no training meets.

    python results/pairs/pilot.py            # plays what is missing in pilot.parquet (of some TASKS: name them),
    python results/pairs/pilot.py --choose   # then prints the choice

Published agents (results/agents.npz, training seed 100) of the lightest settings. Rules are judged over the five tasks
alike, by crash rates: in risky traffic against the treated agent (margin 5 points), in regular traffic against the
control agent (2.5 points). The rule is chosen whose larger miss, in margins, is the smallest. One rule for all tasks.
"""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import torch

import agents
from agents.belief import Weighed
from agents.greedy import Greedy
from experiments.backends import make_env
from experiments.study.compute.evaluate import drives, evaluate
from experiments.study.compute.wrappers import TimeObserved, weighed
from experiments.study.design.estimators import FOLDER
from experiments.study.design.grid import env_config, level_names
from experiments.study.design.traffic import TRAFFICS
from agents.plugins import sha256

FILE = Path(__file__).with_name("pilot.parquet")
SCENARIOS = 100
RULES = {  # sharpness and threshold
    "weights": (1.0, 0.5),
    "sharpened": (3.0, 0.5),
    "sharpened, careful": (3.0, 0.3),
    "threshold .5": (32.0, 0.5),
    "threshold .3": (32.0, 0.3),
}
TASKS = "u-turn", "roundabout", "intersection", "two-way", "highway"
SINGLE = {"control": ("regular",), "treatment": ("risky",)}  # the traffic that the choice needs
KEPT = ["traffic", "scenario", "crashed", "return", "mean_speed"]
MARGINS = {"risky": ("treatment", 5.0), "regular": ("control", 2.5)}


def play(task: str, name: str) -> pd.DataFrame:
    """The episodes of a policy in the pilot's scenarios of a task."""
    setting = f"{task}-{level_names(task)[0]}"
    with closing(make_env("sumo", task, env_config("sumo", task, 1))) as env:
        steps = agents.card(setting, "control")["time_observed"]
        env = TimeObserved(env, steps) if steps else env
        if name in SINGLE:
            policy = Greedy(agents.load(setting, name).network)
        else:
            pair = {"weight": "half"}
            if name in RULES:
                pair = {"weight": "belief", "rule": RULES[name]}
                pair["estimator_sha256"] = sha256(FOLDER / f"{setting}.npz")
            env = weighed(env, pair)
            policy = Weighed(*(Greedy(agents.load(setting, arm).network) for arm in ("control", "treatment")))
        asked = drives(task, 1, range(SCENARIOS), SINGLE.get(name, TRAFFICS), "pilot")
        return evaluate(env, policy, asked)[KEPT].assign(task=task, policy=name)


def choose(rows: pd.DataFrame) -> None:
    """Print differences in points, tasks alike, with their standard errors over scenarios, and what is chosen."""
    found = {}
    for name in ("half", *RULES):
        for traffic, (against, margin) in MARGINS.items():
            table = rows[rows["traffic"] == traffic].pivot(
                index=["task", "scenario"], columns="policy", values="crashed"
            )
            if name not in table or against not in table:
                continue
            each = 100 * (table[name].astype(float) - table[against].astype(float)).dropna()
            tasks = each.groupby("task")
            found[name, traffic] = {
                **tasks.mean().round(1),
                "tasks": tasks.ngroups,
                "mean": tasks.mean().mean(),
                "se": (tasks.sem() ** 2).sum() ** 0.5 / tasks.ngroups,
                "margins": tasks.mean().mean() / margin,
            }
    table = pd.DataFrame(found).T.round(2)
    print(table.to_string())
    worst = table.loc[list(RULES), "margins"].groupby(level=0).max()
    print(worst.sort_values().to_string(), f"\nchosen: {worst.idxmin()} {RULES[str(worst.idxmin())]}")


def main() -> None:
    """Play and choose."""
    torch.set_num_threads(1)
    done = [pd.read_parquet(FILE)] if FILE.exists() else []
    for task in [] if "--choose" in sys.argv else sys.argv[1:] or TASKS:
        for name in (*SINGLE, "half", *RULES):
            if not any(((part["task"] == task) & (part["policy"] == name)).any() for part in done):
                done.append(play(task, name))
                pd.concat(done, ignore_index=True).to_parquet(FILE, index=False)
                print(task, name, done[-1].groupby("traffic")["crashed"].mean().to_dict(), flush=True)
    choose(pd.concat(done, ignore_index=True))


if __name__ == "__main__":
    main()
