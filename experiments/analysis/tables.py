"""From stored episodes to one row a policy: which cells may be compared, and their means.

A result directory may hold cells of several settings (another budget, other versions). They are never
mixed: for each task and traffic level one setting is analysed, the others are set aside and named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from experiments.study.grid import ARMS, TASKS, TRAFFICS
from experiments.study.store import Results
from experiments.support.files import canonical_json

TASK_ORDER = {task: number for number, task in enumerate(TASKS)}
PLACE = ["backend", "task", "level", "level_name"]  # what a comparison is made within


@dataclass(frozen=True)
class Outcome:
    """A quantity of a test episode that is averaged and compared.

    label: for people. unit: of a mean. better: +1 if more is better, -1 if less is, 0 if neither. digits:
    decimals to show. percent: shown as a percentage. poolable: means the same on every task, so may be
    averaged over tasks. margin: difference below which two arms count as equivalent, None where none was
    fixed.
    """

    label: str
    unit: str
    better: int
    digits: int
    percent: bool = False
    poolable: bool = False
    margin: float | None = None


OUTCOMES: dict[str, Outcome] = {
    "return": Outcome("Return", "per episode", +1, 2),
    "crashed": Outcome("Crash rate", "of episodes", -1, 1, percent=True, poolable=True, margin=0.05),
    "mean_speed": Outcome("Mean speed", "m/s", 0, 1, poolable=True, margin=0.5),
    "near_misses": Outcome("Near-misses", "per episode", -1, 2, poolable=True),
    "reward_per_step": Outcome("Reward per step", "", +1, 3),
}
# Decided before looking: the paper's measure, and the one that its conclusion is about.
CONFIRMATORY = ("return", "crashed")
# Means that describe a policy beside its outcomes.
DESCRIPTIVE = ("length", "distance", "arrived", "density", "stopped")
TERMS: dict[str, dict[str, float]] = {
    "risky": {"risky": 1.0},
    "regular": {"regular": 1.0},
    "sum": {"risky": 1.0, "regular": 1.0},
    "interaction": {"risky": 1.0, "regular": -1.0},
}


def _settings(cell: Mapping[str, Any]) -> dict[str, Any]:
    """What a cell is computed with, flat; the preset is a label and no setting."""
    key, versions = cell["key"], cell["versions"]
    flat = {f"{part} {name}": value for part in ("env_config", "eval") for name, value in key[part].items()}
    flat |= {f"version of {name}": value for name, value in versions.items()}
    return flat | {name: value for name, value in key["profile"].items() if name != "preset"}


def _is_learner(setting: str) -> bool:
    """Settings that only cells with a trained agent have."""
    return not setting.startswith(("env_config ", "eval ", "version of "))


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
    expected = set(results.expected)
    places: dict[tuple[Any, ...], list[str]] = {}
    for name, cell in results.cells.items():
        places.setdefault(tuple(cell["key"][column] for column in PLACE), []).append(name)
    for names in places.values():
        groups: dict[str, list[str]] = {}
        agents = [name for name in names if results.cells[name]["key"]["kind"] == "agent"]
        for name in agents or names:
            groups.setdefault(canonical_json(_settings(results.cells[name])), []).append(name)
        best = max(
            groups, key=lambda group: (len(expected.intersection(groups[group])), len(groups[group]), group)
        )
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
    gone = {entry["cell"] for entry in left_out}

    def keep(table: pd.DataFrame) -> pd.DataFrame:
        return table[~table["cell"].isin(gone)].reset_index(drop=True) if gone else table

    cells = {name: cell for name, cell in results.cells.items() if name not in gone}
    tables = {name: keep(getattr(results, name)) for name in ("agents", "episodes", "gate_episodes", "training")}
    return replace(results, cells=cells, **tables), left_out


def units(episodes: pd.DataFrame) -> pd.DataFrame:
    """One row a cell: its key columns and its mean of every outcome in every traffic.

    Columns "<outcome> <traffic>", for example "crashed risky"; `episodes` is the smaller number of test
    episodes of the two traffics. A cell that lacks a traffic is left out: nothing can be said about its
    sum.
    """
    keys = ["cell", "kind", *PLACE, "arm", "seed", "policy"]
    if episodes.empty:
        return pd.DataFrame(columns=keys)
    table = episodes.assign(reward_per_step=episodes["return"] / episodes["length"])
    columns = [*OUTCOMES, *DESCRIPTIVE]
    grouped = table.groupby(["cell", "traffic"], sort=True)
    wide = grouped[columns].mean().astype(float).unstack("traffic")
    wide.columns = [f"{outcome} {traffic}" for outcome, traffic in wide.columns]
    wide["episodes"] = grouped.size().unstack("traffic").min(axis=1)
    complete = [f"return {traffic}" for traffic in TRAFFICS if f"return {traffic}" in wide]
    if len(complete) < len(TRAFFICS):
        return pd.DataFrame(columns=keys)
    key_table = table[keys].drop_duplicates("cell").set_index("cell")
    joined = key_table.join(wide.dropna(subset=complete), how="inner").reset_index()
    joined = joined.assign(order=joined["task"].map(TASK_ORDER))
    return (
        joined.sort_values(["backend", "order", "level", "cell"]).drop(columns="order").reset_index(drop=True)
    )


def place_order(record: Mapping[str, Any]) -> tuple[str, int, int]:
    """Key to sort records by backend, task (in the grid's order) and level."""
    return record["backend"], TASK_ORDER[record["task"]], record["level"]


def term_values(table: pd.DataFrame, outcome: str, term: str) -> pd.Series:
    """A term of the treatment effect for each agent, before anything is compared.

    "risky" and "regular" are the outcome in that traffic, "sum" both together, "interaction" risky minus
    regular.
    """
    return sum(weight * table[f"{outcome} {traffic}"] for traffic, weight in TERMS[term].items())


Pair = Mapping[str, pd.DataFrame]  # arm -> its agents, one row each, indexed by training seed


def pairs(table: pd.DataFrame) -> dict[tuple[Any, ...], Pair]:
    """The trained agents of a table by place (backend, task, level, level_name), split into the two arms."""
    agents = table[table["kind"] == "agent"]
    result: dict[tuple[Any, ...], Pair] = {}
    for place, group in agents.groupby(PLACE, sort=False):
        indexed = group.assign(seed=group["seed"].astype(int)).set_index("seed")
        result[place] = {arm: indexed[indexed["arm"] == arm] for arm in ARMS}
    return result


def arm_values(pair: Pair, outcome: str, term: str) -> tuple[pd.Series, pd.Series]:
    """A term for each trained agent, (treatment, control), indexed by training seed."""
    return term_values(pair["treatment"], outcome, term), term_values(pair["control"], outcome, term)
