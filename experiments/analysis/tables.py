"""From stored episodes to tables: which cells may be compared, their means, and the scores of each setting.

A result directory may hold cells of several settings (another budget, other versions). They are never
mixed: for each task and traffic level one setting is analysed, the others are set aside and named. So are
cells whose tables are not complete.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from experiments.analysis.plan import OUTCOMES, PROPORTIONS, TERMS
from experiments.analysis.statistics import binomial_floor
from experiments.study.arms import ALL_TRAFFICS, ARMS, TRAFFICS, gate_traffics
from experiments.study.grid import TASKS
from experiments.study.results import Results
from experiments.support.files import canonical_json

TASK_ORDER = {task: number for number, task in enumerate(TASKS)}
PLACE = ["backend", "task", "level", "level_name"]  # what a comparison is made within


# The paper's measure, and the one that its conclusion is about: shown first, everything else is exploratory.
CONFIRMATORY = ("return", "crashed")
# Means that describe a policy beside its outcomes.
DESCRIPTIVE = ("length", "distance", "arrived", "density", "stopped")


def _settings(cell: Mapping[str, Any]) -> dict[str, Any]:
    """What a cell is computed with, flat; the preset is a label and no setting."""
    key, versions = cell["key"], cell["versions"]
    flat = {f"{part} {name}": value for part in ("env_config", "eval") for name, value in key[part].items()}
    flat |= {f"version of {name}": value for name, value in versions.items()}
    flat["dynamics"] = key.get("dynamics")
    return flat | {name: value for name, value in key["profile"].items() if name != "preset"}


def _is_learner(setting: str) -> bool:
    """Settings that only cells with a trained agent have."""
    return not setting.startswith(("env_config ", "eval ", "version of ", "dynamics"))


def _difference(settings: Mapping[str, Any], reference: Mapping[str, Any]) -> str:
    names = [name for name in sorted({*settings, *reference}) if settings.get(name) != reference.get(name)]
    words = [f"{name} {settings.get(name)} instead of {reference.get(name)}" for name in names]
    more = f" and {len(words) - 3} more" if len(words) > 3 else ""
    return ", ".join(words[:3]) + more


def comparable(results: Results) -> tuple[Results, list[dict[str, str]]]:
    """The cells that may be compared with each other, and the others with the reason why not.

    For each task and level: the setting that the last sweep asked for, else the one with most cells;
    baselines must have been tested in the same environment, on the same scenarios and under the same
    versions.
    """
    left_out: list[dict[str, str]] = []
    latest = {name: number for number, name in enumerate(results.expected)}  # the last sweep stands last
    places: dict[tuple[Any, ...], list[str]] = {}
    for name, cell in results.cells.items():
        places.setdefault(tuple(cell["key"][column] for column in PLACE), []).append(name)
    for names in places.values():
        groups: dict[str, list[str]] = {}
        agents = [name for name in names if results.cells[name]["key"]["kind"] == "agent"]
        for name in agents or names:
            groups.setdefault(canonical_json(_settings(results.cells[name])), []).append(name)
        asked = {group: max(latest.get(name, -1) for name in groups[group]) for group in groups}
        best = max(groups, key=lambda group: (asked[group], len(groups[group]), group))
        reference = _settings(results.cells[groups[best][0]])
        environment = {name: value for name, value in reference.items() if not _is_learner(name)}
        for name in names:
            is_agent = results.cells[name]["key"]["kind"] == "agent"
            wanted = reference if is_agent else environment
            own = _settings(results.cells[name])
            if not is_agent:
                own = {setting: value for setting, value in own.items() if not _is_learner(setting)}
            if difference := _difference(own, wanted):
                left_out.append({"cell": name, "reason": difference})
    return without(results, {entry["cell"] for entry in left_out}), left_out


def split(results: Results) -> tuple[Results, Results]:
    """The cells of the comparison that the plan is about (both arms and the baselines), and the exploratory ones."""
    main = {
        name
        for name, cell in results.cells.items()
        if cell["key"]["kind"] == "baseline"
        or (cell["key"]["kind"] == "agent" and cell["key"]["arm"] in ARMS)
    }
    return without(results, set(results.cells) - main), without(results, main)


def fitting(extra: Results, main: Results) -> Results:
    """The exploratory cells that are trained and tested as those of the comparison at their place are."""
    wanted: dict[tuple[Any, ...], dict[str, Any]] = {}
    for cell in main.cells.values():
        if cell["key"]["kind"] == "agent":
            wanted.setdefault(tuple(cell["key"][column] for column in PLACE), _settings(cell))
    gone = set()
    for name, cell in extra.cells.items():
        reference = wanted.get(tuple(cell["key"][column] for column in PLACE))
        own = _settings(cell)
        if reference is None or any(own.get(setting) != value for setting, value in reference.items()):
            gone.add(name)
    return without(extra, gone)


def without(results: Results, gone: set[str]) -> Results:
    """The results without some cells."""
    if not gone:
        return results
    tables = {
        name: table[~table["cell"].isin(gone)].reset_index(drop=True)
        for name in ("agents", "episodes", "gate_episodes", "training", "marks")
        for table in [getattr(results, name)]
    }
    return replace(results, cells={k: v for k, v in results.cells.items() if k not in gone}, **tables)


def complete(results: Results) -> tuple[Results, list[dict[str, str]]]:
    """The cells whose tables hold every scenario once and nothing but numbers, and the others with the reason."""
    incomplete = []
    tests = dict(tuple(results.episodes.groupby("cell", sort=False))) if len(results.episodes) else {}
    gates = (
        dict(tuple(results.gate_episodes.groupby("cell", sort=False))) if len(results.gate_episodes) else {}
    )
    for name, cell in results.cells.items():
        key = cell["key"]
        test = key.get("test_on", {"episodes": key["eval"]["episodes"], "traffics": list(TRAFFICS)})
        first = int(key["eval"].get("first_scenario", 0))
        wanted = range(first, first + int(test["episodes"]))
        faults = _faults(tests.get(name), wanted, test["traffics"], "test")
        if "gate_episodes" in key["eval"] and key["kind"] != "test":
            own = gate_traffics(key["arm"])
            wanted = range(first, first + int(key["eval"]["gate_episodes"]))
            faults += _faults(gates.get(name), wanted, own, "gate")
        if faults:
            incomplete.append({"cell": name, "reason": "; ".join(faults)})
    return without(results, {entry["cell"] for entry in incomplete}), incomplete


def _faults(table: pd.DataFrame | None, wanted: range, traffics: Sequence[str], purpose: str) -> list[str]:
    """What is wrong with the episodes of a cell, in words."""
    if table is None:
        return [f"no {purpose} episodes"]
    faults = []
    for traffic in traffics:
        rows = table[table["traffic"] == traffic]
        if sorted(rows["scenario"]) != list(wanted):
            found = rows["scenario"].nunique()
            twice = ", some twice" if len(rows) > found else ""
            faults.append(f"{found} of {len(wanted)} {purpose} scenarios in {traffic} traffic{twice}")
    for column in ("return", "length", "mean_speed", "distance", "near_misses", "crashed"):
        if column in table and not np.isfinite(table[column].astype(float)).all():
            faults.append(f"{column} of the {purpose} is not a number")
    return faults


def duplicates(results: Results) -> list[list[str]]:
    """Groups of trained agents with the same weights: the same cell under several names."""
    by_weights: dict[str, list[str]] = {}
    for name, cell in sorted(results.cells.items()):
        if sha := (cell.get("learner") or {}).get("weights_sha256"):
            by_weights.setdefault(sha, []).append(name)
    return [names for names in by_weights.values() if len(names) > 1]


def with_outcomes(
    episodes: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]], users: bool = True
) -> pd.DataFrame:
    """Episodes with the outcomes that are computed from others; users: also with those of the user's own."""
    frequency = {name: cell["key"]["env_config"].get("policy_frequency", 1) for name, cell in cells.items()}
    lasted = episodes["length"] / episodes["cell"].map(frequency).astype(float)
    crashed = episodes["crashed"].astype(float)
    grouped = episodes.assign(crashed=crashed).groupby(["cell", "traffic"], sort=False)
    way, crashes = grouped["distance"].transform("mean"), grouped["crashed"].transform("mean")
    # A ratio of sums, written so that the mean over an agent's episodes is the ratio and their spread its error.
    rate = crashes / way
    per_metre = rate + (crashed - rate * episodes["distance"]) / way
    own = {name: outcome.of for name, outcome in OUTCOMES.items() if users and outcome.of is not None}
    return episodes.assign(
        **own,
        crashed=crashed,
        reward_per_step=episodes["return"] / episodes["length"],
        crash_free_time=episodes["crash_time"].astype(float).where(crashed > 0).fillna(lasted),
        crashes_per_100_km=per_metre.where(way > 0, 0.0) * 1e5,
    )


def units(episodes: pd.DataFrame) -> pd.DataFrame:
    """One row a cell: its key columns and its mean of every outcome in every traffic.

    Columns "<outcome> <traffic>", for example "crashed risky". `episodes` as from `with_outcomes`.
    """
    keys = ["cell", "kind", *PLACE, "arm", "seed", "policy"]
    if episodes.empty:
        return pd.DataFrame(columns=keys)
    columns = [*OUTCOMES, *DESCRIPTIVE]
    wide = episodes.groupby(["cell", "traffic"], sort=True)[columns].mean().astype(float).unstack("traffic")
    wide.columns = [f"{outcome} {traffic}" for outcome, traffic in wide.columns]
    joined = episodes[keys].drop_duplicates("cell").set_index("cell").join(wide, how="inner").reset_index()
    joined = joined.assign(order=joined["task"].map(TASK_ORDER))
    return (
        joined.sort_values(["backend", "order", "level", "cell"]).drop(columns="order").reset_index(drop=True)
    )


def place_order(record: Mapping[str, Any]) -> tuple[str, int, int]:
    """Key to sort records by backend, task (in the grid's order) and level."""
    return record["backend"], TASK_ORDER[record["task"]], record["level"]


@dataclass(frozen=True)
class Arm:
    """The agents of an arm in a setting, in order of their training seeds.

    values: for each outcome an array (traffic in the order of its dose, seed, scenario).
    """

    seeds: tuple[int, ...]
    cells: tuple[str, ...]
    values: Mapping[str, NDArray[np.float64]]

    def scores(self, outcome: str, term: str) -> NDArray[np.float64]:
        """A term of the treatment effect for each agent and scenario, before anything is compared."""
        weights = np.array([TERMS[term].get(traffic, 0.0) for traffic in TRAFFICS])
        scores: NDArray[np.float64] = np.tensordot(weights, self.values[outcome], axes=1)
        return scores

    def floor(self, outcome: str, term: str) -> float:
        """The least variance of the arm's mean, see `statistics.binomial_floor`."""
        if (outcome in OUTCOMES and outcome not in PROPORTIONS) or not self.seeds:
            return 0.0
        return binomial_floor(
            [x for traffic, x in zip(TRAFFICS, self.values[outcome], strict=True) if traffic in TERMS[term]]
        )

    def only(self, keep: Sequence[bool]) -> Arm:
        """Some of the agents."""
        mask = np.asarray(keep, dtype=bool)
        seeds = tuple(seed for seed, kept in zip(self.seeds, mask, strict=True) if kept)
        cells = tuple(cell for cell, kept in zip(self.cells, mask, strict=True) if kept)
        return Arm(seeds, cells, {name: values[:, mask] for name, values in self.values.items()})

    def below(self, seed: int | None) -> Arm:
        """The agents of the first batches of seeds; all if no limit is given."""
        return self if seed is None else self.only([own < seed for own in self.seeds])


Pair = Mapping[str, Arm]  # by name of the arm
Place = tuple[Any, ...]  # backend, task, level, level_name


def settings(
    episodes: pd.DataFrame, arms: Sequence[str] = tuple(ARMS), outcomes: Sequence[str] | None = None
) -> dict[Place, Pair]:
    """The scores of the trained agents by place, in the grid's order.

    Args:
        episodes: as from `with_outcomes`, with these outcomes as columns; the same traffics for all agents.
    """
    agents = episodes[episodes["arm"].isin(arms)]
    if agents.empty:
        return {}
    traffic = agents["traffic"].map({name: number for number, name in enumerate(ALL_TRAFFICS)})
    agents = agents.assign(
        _traffic=traffic, _task=agents["task"].map(TASK_ORDER), seed=agents["seed"].astype(int)
    )
    agents = agents.sort_values(["backend", "_task", "level", "arm", "_traffic", "seed", "scenario"])
    result: dict[Place, Pair] = {}
    for place, group in agents.groupby(PLACE, sort=False):
        by_arm = dict(tuple(group.groupby("arm")))
        columns = tuple(OUTCOMES) if outcomes is None else outcomes
        result[place] = {arm: _arm(by_arm.get(arm, group.iloc[:0]), columns) for arm in arms}
    return result


def _arm(rows: pd.DataFrame, outcomes: Sequence[str]) -> Arm:
    agents = rows.drop_duplicates("cell")
    traffics = rows["traffic"].nunique() or len(TRAFFICS)
    shape = (traffics, len(agents), -1) if len(agents) else (traffics, 0, 0)
    values = {name: rows[name].to_numpy(dtype=np.float64).reshape(shape) for name in outcomes}
    return Arm(tuple(agents["seed"]), tuple(agents["cell"]), values)
