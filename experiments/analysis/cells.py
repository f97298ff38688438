"""Which stored cells may be compared with each other.

A result directory may hold cells of several settings (another budget, other versions). They are never mixed: for each
task and traffic level one setting is analysed, the others are set aside and named.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import replace
from typing import Any

from agents.rules import POLICIES
from experiments.analysis.scores import SETTING
from experiments.study.design.arms import ARMS
from experiments.study.design.grid import setting
from experiments.study.results.store import Results
from experiments.support.files import canonical_json

Cell = Mapping[str, Any]
ENVIRONMENT = ("env_config ", "eval ", "version of ", "dynamics")  # settings without a trained agent too
FURTHER = re.compile(r"-(doses|unseen|on-[a-z-]+)$")  # how the slugs of further tests end
ALONE = "no agents of both arms with its settings to compare with"


def comparable(results: Results) -> tuple[Results, dict[str, str]]:
    """The cells that may be compared with each other, and the names of the others with the reason why not.

    For each task and level: the setting that the last sweep asked for, else the one with most cells. Baselines must
    have been tested in the same environment, on the same scenarios and under the same versions. Further arms, and tests
    on other simulators, must be of agents trained and tested as those of both arms are.
    """
    left_out: dict[str, str] = {}
    places: dict[tuple[Any, ...], dict[str, Cell]] = {}
    for name, cell in results.cells.items():
        places.setdefault(tuple(cell["key"][column] for column in SETTING), {})[name] = cell
    for cells in places.values():
        left_out |= _of_other_settings(cells, results.expected)
    return leave_out(results, left_out), left_out


def is_main(cell: Cell) -> bool:
    """Whether a cell is of the comparison that the plan is about: an agent of one of both arms, or a baseline."""
    kind = cell["key"]["kind"]
    return kind == "baseline" or (kind == "agent" and cell["key"]["arm"] in ARMS)


def _of_other_settings(cells: Mapping[str, Cell], expected: Sequence[str]) -> dict[str, str]:
    """The cells of a task and level that were computed with other settings, with the reason."""
    settings = {name: _settings(cell) for name, cell in cells.items()}
    main = [name for name, cell in cells.items() if is_main(cell)]
    agents = [name for name in main if cells[name]["key"]["kind"] == "agent"]
    if not main:
        return dict.fromkeys(cells, ALONE)
    groups: dict[str, list[str]] = {}
    for name in agents or main:
        groups.setdefault(canonical_json(settings[name]), []).append(name)
    latest = {name: number for number, name in enumerate(expected)}  # the last sweep stands last
    best = max(
        groups, key=lambda group: (max(latest.get(n, -1) for n in groups[group]), len(groups[group]), group)
    )
    reference, found = settings[groups[best][0]], {}
    for name, own in settings.items():
        if name in main:
            names = [n for n in sorted({*own, *reference}) if name in agents or n.startswith(ENVIRONMENT)]
            pairs = [(n, own.get(n), reference.get(n)) for n in names]
            differing = [f"{n} {mine} instead of {theirs}" for n, mine, theirs in pairs if mine != theirs]
            found[name] = ", ".join(differing[:3])
        elif not agents or not reference.items() <= own.items():
            found[name] = ALONE
    return {name: reason for name, reason in found.items() if reason}


def _settings(cell: Cell) -> dict[str, Any]:
    """What a cell is computed with, flat; the preset is a label and no setting."""
    key, versions = cell["key"], cell["versions"]
    flat = {f"{part} {name}": value for part in ("env_config", "eval") for name, value in key[part].items()}
    flat |= {f"version of {name}": value for name, value in versions.items()}
    flat["dynamics"] = key.get("dynamics")
    if key["arm"]:
        flat["learner"] = key["policy"]
    return flat | {name: value for name, value in key["profile"].items() if name != "preset"}


def unfinished(results: Results, chosen: Results, arms: Sequence[str]) -> dict[str, str]:
    """What is missing of settings: agents of these arms that a sweep has asked for, and that are not chosen.

    Settings are named as in `grid.setting`; those that no sweep has asked for are not named.
    """
    asked: dict[str, list[str]] = {}
    for name in dict.fromkeys((*results.expected, *results.cells)):
        # behind the seed stands the learner, if it is not the study's
        found = re.fullmatch(rf"(.+)-({'|'.join(arms)})-s\d+(-.+)?-[0-9a-f]+", name)
        if found and not FURTHER.search(found[3] or ""):
            asked.setdefault(found[1], []).append(name)
    lacking = {part: sum(name not in chosen.cells for name in names) for part, names in asked.items()}
    return {p: f"{n} of {len(asked[p])} agents are missing" for p, n in lacking.items() if n}


def incomplete(results: Results) -> dict[str, str]:
    """What a comparison lacks, by setting as in `grid.setting`: agents of both arms with the same seeds, baselines."""
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
    """The results without some cells, and without the agents of some settings, named as in `grid.setting`."""
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
