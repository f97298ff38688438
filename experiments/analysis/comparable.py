"""Which stored cells may be compared with each other.

A result directory may hold cells of several groups (another budget, other versions). They are never mixed: for each
task and traffic level one group is analysed. An agent may also have been tested in one traffic of one simulator by
several cells: one of them counts. What is set aside is named.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import pandas as pd

from agents.rules import POLICIES
from experiments.study.design.arms import ARMS
from experiments.study.design.cell import setting_of_agent
from experiments.study.results.loaded import SETTING, Results
from experiments.study.results.store import of_other_weights
from experiments.support.files import canonical_json

ENVIRONMENT = ("env_config ", "eval ", "version of ", "dynamics")  # settings without a trained agent too
ALONE = "no agents of both arms with its settings to compare with"


def comparable(results: Results) -> tuple[Results, dict[str, str]]:
    """The cells that may be compared with each other, and the names of the others with the reason why not.

    For each task and level the latest group of both arms decides. Baselines must have been tested in its environment,
    on its scenarios and under its versions; further arms and tests must be of agents trained and tested as it says. Of
    what fits, each agent has one cell in each traffic of each simulator (`_tested_twice`). A cell that counts in some
    of its traffics alone is among both.
    """
    left_out: dict[str, str] = {}
    in_part: dict[str, str] = {}
    episodes = results.episodes
    for _, cells in results.table.groupby(SETTING, sort=False):
        left_out |= _of_other_groups(cells, results)
        for name, reasons in _tested_twice(cells[~cells["cell"].isin(left_out)], results).items():
            if len(reasons) == len(cells.loc[name, "traffics"]):
                left_out[name] = next(iter(reasons.values()))
                continue
            in_part[name] = "; ".join(f"in {traffic} traffic {why}" for traffic, why in reasons.items())
            episodes = episodes[~(episodes["cell"].eq(name) & episodes["traffic"].isin(list(reasons)))]
    return leave_out(replace(results, episodes=episodes), left_out), left_out | in_part


def main_cells(table: pd.DataFrame) -> pd.DataFrame:
    """The cells of the comparison that the plan is about: agents of both arms, and baselines."""
    return table[(table["kind"] == "baseline") | (table["kind"] == "agent") & table["arm"].isin(ARMS)]


def _of_other_groups(cells: pd.DataFrame, results: Results) -> dict[str, str]:
    """The cells of a task and level that belong to another group, with the reason."""
    groups = {name: group(results.cells[name]) for name in cells["cell"]}
    main = main_cells(cells)
    if main.empty:
        return dict.fromkeys(groups, ALONE)
    agents = list(main.loc[main["kind"] == "agent", "cell"])
    reference, found = _latest(agents or list(main["cell"]), groups, results.order), {}
    for name, own in groups.items():
        if name in main.index:
            shared = {*own, *reference}
            if name not in agents:  # packages of the learner alone are nothing to a baseline
                shared -= {n for n in reference if n.startswith("version of ") and n not in own}
                shared = {n for n in shared if n.startswith(ENVIRONMENT)}
            found[name] = _differing(own, reference, shared)
        elif not agents or not reference.items() <= own.items():
            found[name] = ALONE
        elif tested := results.cells[name].get("tested"):
            agent = results.cells.get(tested["cell"])
            if agent and of_other_weights(results.cells[name], agent):
                found[name] = "its agent was trained again"
    return {name: reason for name, reason in found.items() if reason}


def _tested_twice(cells: pd.DataFrame, results: Results) -> dict[str, dict[str, str]]:
    """The cells that do not count in some of their traffics, with the reasons by traffic.

    An agent's own cell counts before further tests of it. Of several, those of the latest group count in all agents of
    an arm, and of an agent the cell that was asked for last.
    """
    groups = {name: group(results.cells[name]) for name in cells["cell"]}
    for own in groups.values():  # in which other traffics a cell tests decides nothing
        own.pop("test_on traffics", None)
    order, found = results.order, dict[str, dict[str, str]]()
    for (_, _, traffic), alike in cells.explode("traffics").groupby(
        ["who", "tested_on", "traffics"], sort=False
    ):
        own = alike[alike["kind"] != "test"]
        best = _latest(list((alike if own.empty else own)["cell"]), groups, order)
        for _, names in alike.groupby("seed", dropna=False, sort=False)["cell"]:
            *others, last = sorted(names, key=lambda name: (groups[name] == best, order.get(name, -1), name))
            reason = f"{last} counts"
            if groups[last] != best:
                reason = "its agent's own test is not here"
                others.append(last)
            for name in others:
                is_alike = own.empty or name in own.index
                differing = _differing(groups[name], best, {*groups[name], *best}) if is_alike else ""
                found.setdefault(name, {})[traffic] = differing or reason
    return found


def _latest(
    names: Sequence[str], groups: Mapping[str, dict[str, Any]], order: Mapping[str, int]
) -> dict[str, Any]:
    """The group of these cells that the last sweep asked for, else the one with most of them."""
    members: dict[str, list[str]] = {}
    for name in names:
        members.setdefault(canonical_json(groups[name]), []).append(name)
    best = max(members.items(), key=lambda one: (max(order.get(n, -1) for n in one[1]), len(one[1]), one[0]))
    return groups[best[1][0]]


def _differing(own: Mapping[str, Any], reference: Mapping[str, Any], names: Collection[str]) -> str:
    """In what a group differs from another, among the entries of these names; empty if it does not."""
    pairs = [(name, own.get(name), reference.get(name)) for name in sorted(names)]
    return ", ".join(
        [f"{name} {mine} instead of {theirs}" for name, mine, theirs in pairs if mine != theirs][:3]
    )


def group(cell: Mapping[str, Any]) -> dict[str, Any]:
    """What a cell is computed with, flat: all of its key and versions but the kind, arm, seed and preset.

    Cells of one place that differ in it are of two versions, and never share a mean.
    """
    key = {
        name: value for name, value in cell["key"].items() if name not in ("kind", "arm", "seed", "policy")
    }
    flat = {f"version of {name}": value for name, value in cell["versions"].items()}
    flat |= {name: value for name, value in key.pop("profile").items() if name != "preset"}
    if cell["key"]["arm"]:
        flat["learner"] = cell["key"]["policy"]
    for name, value in key.items():
        flat |= (
            {f"{name} {entry}": inner for entry, inner in value.items()}
            if isinstance(value, dict)
            else {name: value}
        )
    return flat


def unfinished(results: Results, chosen: Results) -> dict[str, str]:
    """What is missing of settings: agents of both arms that a sweep has asked for, and that are not chosen.

    Settings are named as in `cell.setting`; those that no sweep has asked for are not named.
    """
    asked: dict[str, list[str]] = {}
    # of some of them nothing but their names is there
    for name in dict.fromkeys((*results.expected, *results.cells)):
        if setting := setting_of_agent(name):
            asked.setdefault(setting, []).append(name)
    lacking = {part: sum(name not in chosen.cells for name in names) for part, names in asked.items()}
    return {p: f"{n} of {len(asked[p])} agents are missing" for p, n in lacking.items() if n}


def incomplete(results: Results) -> dict[str, str]:
    """What a comparison lacks, by setting as in `cell.setting`: agents of both arms with the same seeds, baselines."""
    reasons = {}
    for name, here in main_cells(results.table).groupby("setting", sort=False):
        absent = [who for who in (*ARMS, *POLICIES) if who not in set(here["who"])]
        seeds = [sorted(here.loc[here["who"] == arm, "seed"]) for arm in ARMS]
        said = [f"nothing of {', '.join(absent)}"] if absent else []
        if seeds[0] != seeds[1]:
            said.append("the arms have other seeds")
        elif len(seeds[0]) == 1:
            said.append("one agent in an arm, so that there is no interval")
        if said:
            reasons[str(name)] = "; ".join(said)
    return reasons


def leave_out(results: Results, gone: Collection[str] = (), settings: Collection[str] = ()) -> Results:
    """The results without some cells, and without the agents of some settings, named as in `cell.setting`."""
    table = results.table
    stays = table["kind"].eq("baseline") | ~table["setting"].isin(list(settings))
    stay = {name: results.cells[name] for name in table.loc[stays, "cell"] if name not in gone}
    episodes, gates = (
        rows[rows["cell"].isin(stay)].reset_index(drop=True)
        for rows in (results.episodes, results.gate_episodes)
    )
    return replace(results, cells=stay, episodes=episodes, gate_episodes=gates)
