"""What is looked at beside the plan's question. Nothing here decides a claim, and every p-value is unadjusted.

arms         agents of further arms against control (and dense traffic against the treatment)
doses        crash rate by the dose of risk in training and in the test
transfer     the same agents tested on another simulator
crash types  which crashes the treatment removes
worst        the worst tenth of an agent's episodes
budget       the effect after a third and two thirds of the training
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from experiments.analysis import statistics
from experiments.analysis.effects import Record, as_record, cells_of, contrast, least
from experiments.analysis.plan import DEFAULT, Plan
from experiments.analysis.pooling import ALL_TASKS, Pairs, by_task, task_weights
from experiments.analysis.statistics import OK, Mean
from experiments.analysis.tables import PLACE, place_order, settings, with_outcomes
from experiments.analysis.wording import place
from experiments.study.arms import ALL_TRAFFICS, ARMS, DOSE_ARMS, DOSES, EXTRA_ARMS
from experiments.study.grid import MARKS
from experiments.study.results import Results

OUTCOMES = ("crashed", "return")
# Kinds of crashes by the pose of the other vehicle in the ego's frame (`crash_type`); "striking": the other's centre is
# ahead of the ego's front, "struck": it is not. "cut-in": two vehicles in one direction, one of which moves sideways
# into the other's lane (their headings differ by more than 3 degrees and converge); which one cannot be told.
CRASH_TYPES = (
    "rear-end, striking", "rear-end, struck", "cut-in", "side", "frontal", "junction, striking", "junction, struck",
)  # fmt: skip
FRONT = 2.5  # [m] from the ego's centre to its front
CONVERGING = 0.05  # [rad]
WORST = 0.1  # share of an agent's episodes


def exploratory(main: Results, extra: Results, plan: Plan = DEFAULT) -> dict[str, Any]:
    """All exploratory results.

    Args:
        main: the cells of the comparison. extra: those of further arms and tests, see `tables.split`.

    Returns:
        arms, doses, transfer, crash_types, worst, budget: see the functions; positive_control: see `positive_control`.
    """
    cells = {**main.cells, **extra.cells}
    agents = {name for name, cell in cells.items() if cell["key"]["kind"] == "agent"}
    played = pd.concat([main.episodes, extra.episodes], ignore_index=True)
    episodes = with_outcomes(played, cells)
    own = episodes[episodes["cell"].isin(agents)]
    compared = own[own["arm"].isin(ARMS)]
    further = arms(settings(own, tuple(DOSES)))
    return {
        "arms": further,
        "doses": doses(episodes[~episodes["cell"].isin(_elsewhere(cells))], cells),
        "transfer": transfer(episodes, cells),
        "crash_types": crash_types(compared),
        "worst": worst(settings(compared)),
        "budget": budget(main, compared),
        "positive_control": positive_control(further, plan),
    }


def _elsewhere(cells: Mapping[str, Mapping[str, Any]]) -> set[str]:
    """Cells that are tested on another simulator than the agent was trained on, and baselines."""
    return {
        name
        for name, cell in cells.items()
        if cell["key"]["kind"] == "baseline"
        or cell["key"].get("test_on", {}).get("backend", cell["key"]["backend"]) != cell["key"]["backend"]
    }


def _scopes(pairs: Pairs) -> list[tuple[str, Pairs]]:
    """Every setting with both arms, and all of them."""
    whole = {where: pair for where, pair in pairs.items() if least(pair)}
    single = [(place(dict(zip(PLACE, where, strict=True))), {where: pair}) for where, pair in whole.items()]
    return [*single, (ALL_TASKS, whole)] if whole else []


def _backends(pairs: Pairs) -> list[tuple[str, Pairs]]:
    names = dict.fromkeys(str(where[0]) for where in pairs)
    return [(name, {where: pair for where, pair in pairs.items() if where[0] == name}) for name in names]


def _mean(pairs: Pairs, outcome: str, term: str) -> Mean:
    return statistics.combine([contrast(pair, outcome, term) for pair in pairs.values()], task_weights(pairs))


def _rates(pairs: Pairs, outcome: str, term: str) -> Record:
    """Means of both arms, every task weighted alike."""
    return {
        f"mean_{arm}": sum(
            weight * float(pair[arm].scores(outcome, term).mean())
            for pair, weight in zip(pairs.values(), task_weights(pairs), strict=True)
        )
        for arm in ("treatment", "control")
    }


def _estimates(pairs: Pairs, outcomes: Sequence[str], **fixed: Any) -> list[Record]:
    """Effects by scope, outcome and test traffic."""
    return [
        {
            **fixed, "scope": scope, "outcome": outcome, "term": term, "settings": len(group),
            **as_record(statistics.interval(_mean(group, outcome, term))),
            **_rates(group, outcome, term), "cells": cells_of(group.values()),
        }
        for scope, group in _scopes(pairs)
        for outcome in outcomes
        for term in ("risky", "regular")
        if scope != ALL_TASKS or outcome == "crashed"
    ]  # fmt: skip


def arms(pairs: Pairs) -> list[Record]:
    """Further arms against control, and dense traffic against the treatment too.

    Returns:
        Records with backend, arm, against, scope (a setting or all tasks alike), outcome, term ("risky" or "regular"),
        settings, the fields of an estimate, mean_treatment (of this arm), mean_control (of the other one) and cells.
    """
    records = []
    for backend, own in _backends(pairs):
        for arm in EXTRA_ARMS:
            for against in ARMS:
                if against == "control" or arm == "dense":
                    two = {where: {"treatment": p[arm], "control": p[against]} for where, p in own.items()}
                    records += _estimates(two, OUTCOMES, backend=backend, arm=arm, against=against)
    return records


def positive_control(records: Sequence[Record], plan: Plan = DEFAULT) -> list[Record]:
    """Whether the effect of a doubled penalty for crashes is found: fewer crashes in the traffic of the training.

    Returns:
        The record of `arms` of each backend that has this arm, with found.
    """
    return [
        {**r, "found": r["status"] == OK and r["p"] < plan.alpha and r["estimate"] < 0}
        for r in records
        if (r["arm"], r["scope"], r["outcome"], r["term"]) == ("penalty", ALL_TASKS, "crashed", "regular")
    ]


def doses(episodes: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]]) -> list[Record]:
    """Crash rate by the dose of risk in training and in the test.

    Args:
        episodes: of agents, on the simulator that they were trained on.

    Returns:
        A record per setting that has agents trained at a dose between 0 and 1: place, doses (of training), tests (doses
        of the tests), rates (a row per training dose; None where it was not tested), seeds (of each row), and slope:
        the change of the crash rate in risky traffic per full dose in training, as an estimate.
    """
    records = []
    trained = episodes[episodes["arm"].isin(DOSE_ARMS) & episodes["traffic"].isin(ALL_TRAFFICS)]
    for where, group in trained.groupby(PLACE, sort=False):
        present = [arm for arm in DOSE_ARMS if (group["arm"] == arm).any()]
        if len(present) < 3:
            continue
        rates = group.groupby(["arm", "traffic"])["crashed"].mean()
        tests = sorted(group["traffic"].unique(), key=ALL_TRAFFICS.__getitem__)
        home = group[group["cell"].map(lambda name: cells[name]["key"]["kind"] == "agent")]
        pair = settings(home, present)[tuple(where)]
        weights = statistics.slope_weights([DOSES[arm] for arm in present])
        scores = [
            (pair[arm].scores("crashed", "risky"), weight)
            for arm, weight in zip(present, weights, strict=True)
        ]
        floor = sum(
            weight**2 * pair[arm].floor("crashed", "risky")
            for arm, weight in zip(present, weights, strict=True)
        )
        records.append(
            {
                **dict(zip(PLACE, where, strict=True)),
                "doses": [DOSES[arm] for arm in present],
                "tests": [ALL_TRAFFICS[traffic] for traffic in tests],
                "rates": [[rates.get((arm, traffic)) for traffic in tests] for arm in present],
                "seeds": [len(pair[arm].seeds) for arm in present],
                "slope": as_record(statistics.interval(statistics.linear(scores, floor))),
                "cells": sorted(group["cell"].unique()),
            }
        )
    return sorted(records, key=place_order)


def transfer(episodes: pd.DataFrame, cells: Mapping[str, Mapping[str, Any]]) -> list[Record]:
    """The effect on the crash rate where agents are tested on another simulator than they were trained on.

    Returns:
        Records with backend (of the training), tested_on, the fields of `arms`, and at_home: the same agents on the
        same scenarios on the simulator of their training, as another such record.
    """
    tests: dict[str, list[str]] = {}
    for name in _elsewhere(cells):
        if test_on := cells[name]["key"].get("test_on"):
            tests.setdefault(test_on["backend"], []).append(name)
    trained = episodes[episodes["cell"].isin(name for name in cells if cells[name]["key"]["kind"] == "agent")]
    agent = [*PLACE, "arm", "seed"]
    records = []
    for other, names in sorted(tests.items()):
        away = episodes[episodes["cell"].isin(names)].merge(trained[agent].drop_duplicates())
        homes = dict(_backends(settings(trained.merge(away[[*agent, "traffic", "scenario"]]))))
        for backend, pairs in _backends(settings(away)):
            here = _estimates(pairs, ("crashed",), backend=backend, tested_on=other)
            home = _estimates(homes[backend], ("crashed",), backend=backend, tested_on=backend)
            records += [{**r, "at_home": h} for r, h in zip(here, home, strict=True)]
    return records


def kind_of_crash(episodes: pd.DataFrame) -> pd.Series:
    """The kind of each episode's crash, of CRASH_TYPES; empty where there is none, or it is not recorded."""
    x, y, turn = (
        episodes[f"crash_relative_{name}"].astype(float).fillna(0.0) for name in ("x", "y", "heading")
    )
    kind = episodes["crash_type"].astype(object).where(episodes["crashed"].astype(float) > 0, "")
    same_way = kind.isin(["rear-end", "side"])
    cut_in = same_way & (-np.sign(y) * np.sin(turn) > CONVERGING)
    role = pd.Series(np.where(x > FRONT, ", striking", ", struck"), index=episodes.index)
    named = kind.where(~kind.isin(["rear-end", "junction"]), kind.astype(str) + role)
    return named.where(~cut_in, "cut-in").fillna("")


def crash_types(episodes: pd.DataFrame) -> list[Record]:
    """Effects on the share of episodes that end in each kind of crash, all tasks alike and task by task.

    Returns:
        Records with backend, kind, scope (a task, or all of them alike), and the fields of `arms`.
    """
    kind = kind_of_crash(episodes)
    table = episodes.assign(**{name: (kind == name).astype(float) for name in CRASH_TYPES})
    records = []
    for backend, pairs in _backends(settings(table, outcomes=CRASH_TYPES)):
        tasks = by_task(pairs)
        scopes = [*tasks.items(), (ALL_TASKS, {w: p for group in tasks.values() for w, p in group.items()})]
        for scope, group in scopes if tasks else []:
            for name in CRASH_TYPES:
                for term in ("risky", "regular"):
                    found = as_record(statistics.interval(_mean(group, name, term)))
                    record = {"backend": backend, "kind": name, "scope": scope, "term": term, **found}
                    records.append({**record, **_rates(group, name, term), "cells": cells_of(group.values())})
    return records


def worst(pairs: Pairs) -> list[Record]:
    """Effects on the time to crash [s] in the worst tenth of each agent's episodes in risky traffic.

    Returns:
        Records with backend, scope (a setting or all tasks alike), the fields of an estimate, mean_treatment,
        mean_control and cells.
    """
    records = []
    for backend, own in _backends(pairs):
        for scope, group in _scopes(own):
            tails = [
                {name: _tail(arm.scores("crash_free_time", "risky")) for name, arm in pair.items()}
                for pair in group.values()
            ]
            means = [statistics.linear([(t["treatment"], 1.0), (t["control"], -1.0)]) for t in tails]
            weights = task_weights(group)
            record: Record = {"backend": backend, "scope": scope}
            record |= as_record(statistics.interval(statistics.combine(means, weights)))
            for arm in ("treatment", "control"):
                record[f"mean_{arm}"] = sum(
                    w * float(t[arm].mean()) for w, t in zip(weights, tails, strict=True)
                )
            records.append({**record, "cells": cells_of(group.values())})
    return records


def _tail(scores: np.ndarray) -> np.ndarray:
    """Mean of the lowest tenth of each agent's scores, (seeds, 1)."""
    count = max(1, round(WORST * scores.shape[1]))
    tail: np.ndarray = np.sort(scores, axis=1)[:, :count].mean(axis=1, keepdims=True)
    return tail


def budget(main: Results, episodes: pd.DataFrame) -> list[Record]:
    """Effects on the crash rate after parts of the training, all tasks alike.

    Returns:
        Records with backend, share (of the budget), and the fields of `arms`. Empty where no such tests are stored.
    """
    if main.marks.empty:
        return []
    marks = with_outcomes(main.marks, main.cells, users=False)
    tables = [(share, marks[marks["mark"] == number]) for number, share in enumerate(MARKS, start=1)]
    return [
        record
        for share, table in [*tables, (1.0, episodes)]
        for backend, pairs in _backends(settings(table, outcomes=("crashed",)))
        for record in _estimates(pairs, ("crashed",), backend=backend, share=share)
        if record["scope"] == ALL_TASKS
    ]
