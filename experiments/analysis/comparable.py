"""Which stored cells may be compared with each other.

A result directory may hold cells of several groups (another budget, other versions). They are never mixed: for each
task and traffic level, and each arm and kind of test there, one group is analysed; the others are set aside and named.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Container, Mapping, Sequence
from dataclasses import replace
from typing import Any

from agents.rules import POLICIES
from experiments.analysis.scores import SETTING
from experiments.study.design.arms import ARMS
from experiments.study.design.cell import setting
from experiments.study.results.store import Results
from experiments.support.files import canonical_json

Cell = Mapping[str, Any]
ENVIRONMENT = ("env_config ", "eval ", "version of ", "dynamics")  # settings without a trained agent too
FURTHER = re.compile(r"-(doses|unseen|on-[a-z-]+)$")  # how the slugs of further tests end
ALONE = "no agents of both arms with its settings to compare with"


def comparable(results: Results) -> tuple[Results, dict[str, str]]:
    """The cells that may be compared with each other, and the names of the others with the reason why not.

    For each task and level the latest group of both arms decides. Baselines must have been tested in its environment,
    on its scenarios and under its versions; further arms and tests must be of agents trained and tested as it says. Of
    what fits, each arm, policy and kind of test has a latest group of its own (`_latest`).
    """
    left_out: dict[str, str] = {}
    places: dict[tuple[Any, ...], dict[str, Cell]] = {}
    for name, cell in results.cells.items():
        places.setdefault(tuple(cell["key"][column] for column in SETTING), {})[name] = cell
    for cells in places.values():
        left_out |= _of_other_groups(cells, results.expected)
    return leave_out(results, left_out), left_out


def is_main(cell: Cell) -> bool:
    """Whether a cell is of the comparison that the plan is about: an agent of one of both arms, or a baseline."""
    kind = cell["key"]["kind"]
    return kind == "baseline" or (kind == "agent" and cell["key"]["arm"] in ARMS)


def _of_other_groups(cells: Mapping[str, Cell], expected: Sequence[str]) -> dict[str, str]:
    """The cells of a task and level that belong to another group, with the reason."""
    groups = {name: group(cell) for name, cell in cells.items()}
    main = [name for name, cell in cells.items() if is_main(cell)]
    agents = [name for name in main if cells[name]["key"]["kind"] == "agent"]
    if not main:
        return dict.fromkeys(cells, ALONE)
    reference, found = _latest(agents or main, groups, expected), {}
    for name, own in groups.items():
        if name in main:
            shared = {*own, *reference}
            if name not in agents:  # packages of the learner alone are nothing to a baseline
                shared -= {n for n in reference if n.startswith("version of ") and n not in own}
                shared = {n for n in shared if n.startswith(ENVIRONMENT)}
            found[name] = _differing(own, reference, shared)
        elif not agents or not reference.items() <= own.items():
            found[name] = ALONE
    places: dict[tuple[Any, ...], list[str]] = {}
    for name in (name for name in cells if not found.get(name)):
        places.setdefault(_place(cells[name]["key"]), []).append(name)
    for names in places.values():
        best = _latest(names, groups, expected)
        found |= {name: _differing(groups[name], best, {*groups[name], *best}) for name in names}
    return {name: reason for name, reason in found.items() if reason}


def _place(key: Mapping[str, Any]) -> tuple[Any, ...]:
    """What a cell is there for at its task and level, whatever its group: an arm or a policy, and a kind of test."""
    test = key.get("test_on") or {}
    return key["arm"] or key["policy"], test.get("backend"), *sorted(test.get("traffics", ()))


def _latest(
    names: Sequence[str], groups: Mapping[str, dict[str, Any]], expected: Sequence[str]
) -> dict[str, Any]:
    """The group of these cells that the last sweep asked for, else the one with most of them."""
    members: dict[str, list[str]] = {}
    for name in names:
        members.setdefault(canonical_json(groups[name]), []).append(name)
    order = {name: number for number, name in enumerate(expected)}  # the last sweep stands last
    best = max(members.items(), key=lambda one: (max(order.get(n, -1) for n in one[1]), len(one[1]), one[0]))
    return groups[best[1][0]]


def _differing(own: Mapping[str, Any], reference: Mapping[str, Any], names: Collection[str]) -> str:
    """In what a group differs from another, among the entries of these names; empty if it does not."""
    pairs = [(name, own.get(name), reference.get(name)) for name in sorted(names)]
    return ", ".join(
        [f"{name} {mine} instead of {theirs}" for name, mine, theirs in pairs if mine != theirs][:3]
    )


def group(cell: Cell) -> dict[str, Any]:
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
    flat.pop("pair agents", None)  # whose seeds they are
    return flat


def unfinished(results: Results, chosen: Results) -> dict[str, str]:
    """What is missing of settings: agents of both arms that a sweep has asked for, and that are not chosen.

    Settings are named as in `cell.setting`; those that no sweep has asked for are not named.
    """
    asked: dict[str, list[str]] = {}
    for name in dict.fromkeys((*results.expected, *results.cells)):
        # behind the seed stands the learner, if it is not the study's
        found = re.fullmatch(rf"(.+)-({'|'.join(ARMS)})-s\d+(-.+)?-[0-9a-f]+", name)
        if found and not FURTHER.search(found[3] or ""):
            asked.setdefault(found[1], []).append(name)
    lacking = {part: sum(name not in chosen.cells for name in names) for part, names in asked.items()}
    return {p: f"{n} of {len(asked[p])} agents are missing" for p, n in lacking.items() if n}


def incomplete(results: Results) -> dict[str, str]:
    """What a comparison lacks, by setting as in `cell.setting`: agents of both arms with the same seeds, baselines."""
    found: dict[str, dict[str, list[Any]]] = {}
    for cell in results.cells.values():
        key = cell["key"]
        if is_main(cell):
            here = found.setdefault(setting(key), {})
            here.setdefault(key["arm"] or key["policy"], []).append(key["seed"])
    reasons = {}
    for name, here in found.items():
        absent = [policy for policy in (*ARMS, *POLICIES) if policy not in here]
        seeds = [sorted(here.get(arm, ())) for arm in ARMS]
        said = [f"nothing of {', '.join(absent)}"] if absent else []
        if seeds[0] != seeds[1]:
            said.append("the arms have other seeds")
        elif len(seeds[0]) == 1:
            said.append("one agent in an arm, so that there is no interval")
        if said:
            reasons[name] = "; ".join(said)
    return reasons


def leave_out(results: Results, gone: Container[str] = (), settings: Container[str] = ()) -> Results:
    """The results without some cells, and without the agents of some settings, named as in `cell.setting`."""
    stay = {
        name: cell
        for name, cell in results.cells.items()
        if name not in gone and (cell["key"]["kind"] == "baseline" or setting(cell["key"]) not in settings)
    }
    episodes, gates = (
        table[table["cell"].isin(stay)].reset_index(drop=True)
        for table in (results.episodes, results.gate_episodes)
    )
    return replace(results, cells=stay, episodes=episodes, gate_episodes=gates)
