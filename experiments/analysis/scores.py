"""From test episodes to the scores of each arm: its agents' outcomes on the scenarios that all of them met."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.analysis.estimate import Scores, binomial_floor
from experiments.analysis.plan import OUTCOMES, PROPORTIONS, TERMS
from experiments.study.arms import ALL_TRAFFICS, TRAFFICS
from experiments.study.store import Results
from sumo_env.tasks import TASKS

PLACE = ["backend", "task", "level", "level_name"]  # a setting: what a comparison is made within
TASK_ORDER = {task: number for number, task in enumerate(TASKS)}
# Kinds of crashes by the pose of the other vehicle in the ego's frame (`crash_type`); "striking": the other's centre is
# ahead of the ego's front, "struck": it is not. "cut-in": two vehicles in one direction, one of which moves sideways
# into the other's lane (their headings differ by more than 3 degrees and converge); which one cannot be told.
CRASH_KINDS = (
    "rear-end, striking",
    "rear-end, struck",
    "cut-in",
    "side",
    "frontal",
    "junction, striking",
    "junction, struck",
)
FRONT = 2.5  # [m] from the ego's centre to its front
CONVERGING = 0.05  # [rad]


def in_order(rows: pd.DataFrame, *columns: str) -> pd.DataFrame:
    """The rows sorted by columns, tasks and traffics in the grid's order."""
    order = {"task": TASK_ORDER, "traffic": ALL_TRAFFICS}
    return rows.sort_values(
        list(columns), key=lambda column: column.map(order[column.name]) if column.name in order else column
    )


def with_outcomes(results: Results) -> pd.DataFrame:
    """The test episodes with all outcomes as columns: those of the plan and the user's own, and the kinds of crashes.

    Columns beside those of `results.episodes`: the names of `plan.OUTCOMES` and of CRASH_KINDS; tested_on (the
    simulator of the test) and seconds (that the episode was to last).
    """
    keys = {name: cell["key"] for name, cell in results.cells.items()}
    settings = pd.DataFrame(
        {
            name: {
                "frequency": key["env_config"].get("policy_frequency", 1),
                "seconds": key["env_config"].get("duration", TASKS[key["task"]].defaults["duration"]),
                "tested_on": key.get("test_on", {}).get("backend", key["backend"]),
            }
            for name, key in keys.items()
        }
    ).T
    episodes = results.episodes.join(settings[["tested_on", "seconds"]], on="cell")
    lasted = episodes["length"] / episodes["cell"].map(settings["frequency"]).astype(float)
    crashed = episodes["crashed"].astype(float)
    grouped = episodes.assign(crashed=crashed).groupby(["cell", "traffic"], sort=False)
    way, crashes = grouped["distance"].transform("mean"), grouped["crashed"].transform("mean")
    # A ratio of sums, written so that the mean over an agent's episodes is the ratio and their spread its error.
    rate = crashes / way
    per_metre = rate + (crashed - rate * episodes["distance"]) / way
    kind = kind_of_crash(episodes)
    own = {name: outcome.of for name, outcome in OUTCOMES.items() if outcome.of is not None}
    return episodes.assign(
        **own,
        **{name: (kind == name).astype(float) for name in CRASH_KINDS},
        seconds=episodes["seconds"].astype(float),
        crashed=crashed,
        reward_per_step=episodes["return"] / episodes["length"],
        crash_free_time=episodes["crash_time"].astype(float).where(crashed > 0).fillna(lasted),
        crashes_per_100_km=per_metre.where(way > 0, 0.0) * 1e5,
    )


def kind_of_crash(episodes: pd.DataFrame) -> pd.Series:
    """The kind of each episode's crash, of CRASH_KINDS; empty where there is none, or it is not recorded."""
    x, y, turn = (
        episodes[f"crash_relative_{name}"].astype(float).fillna(0.0) for name in ("x", "y", "heading")
    )
    kind = episodes["crash_type"].astype(object).where(episodes["crashed"].astype(float) > 0, "")
    same_way = kind.isin(["rear-end", "side"])
    cut_in = same_way & (-np.sign(y) * np.sin(turn) > CONVERGING)
    role = pd.Series(np.where(x > FRONT, ", striking", ", struck"), index=episodes.index)
    named = kind.where(~kind.isin(["rear-end", "junction"]), kind.astype(str) + role)
    return named.where(~cut_in, "cut-in").fillna("")


@dataclass(frozen=True)
class Arm:
    """The agents of an arm in a setting, in order of their training seeds.

    values: for each outcome an array (traffic in the order of TRAFFICS, seed, scenario).
    """

    seeds: tuple[int, ...]
    values: Mapping[str, NDArray[np.float64]]

    def scores(self, outcome: str, term: str) -> Scores:
        """A term of the treatment effect for each agent and scenario, before anything is compared."""
        weights = np.array([TERMS[term].get(traffic, 0.0) for traffic in TRAFFICS])
        scores: Scores = np.tensordot(weights, self.values[outcome], axes=1)
        return scores

    def tested(self, outcome: str, term: str) -> list[Scores]:
        """The outcome in each traffic of a term."""
        tables = zip(TRAFFICS, self.values[outcome], strict=True)
        return [table for traffic, table in tables if TERMS[term].get(traffic)]

    def floor(self, outcome: str, term: str) -> float:
        """The least variance of the arm's mean, see `estimate.binomial_floor`."""
        if outcome not in (*PROPORTIONS, *CRASH_KINDS):
            return 0.0
        return binomial_floor(self.tested(outcome, term))

    def below(self, seed: int) -> Arm:
        """The agents of the first batches of training seeds."""
        kept = np.array([own < seed for own in self.seeds])
        values = {name: table[:, kept] for name, table in self.values.items()}
        return self if kept.all() else Arm(tuple(np.array(self.seeds)[kept].tolist()), values)


Place = tuple[str, str, int, str]  # backend, task, level, level_name
Arms = Mapping[str, Arm]  # by name


def arms_of(episodes: pd.DataFrame, outcomes: Sequence[str]) -> dict[Place, dict[str, Arm]]:
    """The scores by setting and arm, in the grid's order.

    Args:
        episodes: as from `with_outcomes`, of agents that all met the same scenarios; the arm's name is in "arm".
    """
    rows = episodes[episodes["traffic"].isin(list(TRAFFICS))]
    rows = in_order(rows, "backend", "task", "level", "arm", "traffic", "seed", "scenario")
    result: dict[Place, dict[str, Arm]] = {}
    for (*place, arm), group in rows.groupby([*PLACE, "arm"], sort=False):
        seeds = tuple(int(seed) for seed in group["seed"].unique())
        shape = (len(TRAFFICS), len(seeds), -1)
        values = {name: group[name].to_numpy(dtype=np.float64).reshape(shape) for name in outcomes}
        result.setdefault((place[0], place[1], place[2], place[3]), {})[str(arm)] = Arm(seeds, values)
    return result
