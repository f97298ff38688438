"""What every report and page leads with, as people read it: the tasks, the means over them, and where agents fail."""

from collections.abc import Callable, Iterable, Mapping
from itertools import product
from typing import Any

import pandas as pd

from experiments.analysis.analysis import Analysis
from experiments.analysis.by_task import COLUMNS
from experiments.analysis.effects import ALL_TASKS
from experiments.analysis.scores import in_order
from experiments.reporting.tables import BACKENDS, MINUS, NONE, chosen, effect, points, titled, wide
from experiments.study.design.levels import tasks_known
from experiments.study.design.traffic import TRAFFICS

WITHOUT_EVENTS = "only-parameters"
# Of a side as `sides` and as `takeover.skill_or_caution` name it: treated agents have less, more, or it is not decided.
SIGNS = {"less": MINUS, "more": "+", "open": "·"}
SIGNS |= {"treated agents": MINUS, "control agents": "+", "not decided": "·"}
HOPELESS = 0.8  # crash rate of the best rule in regular traffic


def places(analysis: Analysis, backend: str) -> dict[tuple[str, str], str]:
    """Where both arms are tested, as (simulator, traffic), and the words for it: at home, without events, elsewhere."""
    rows = chosen(analysis.by_task, backend=backend)
    known = {(backend, traffic): f"{traffic} traffic" for traffic in reversed(TRAFFICS)}
    known[backend, WITHOUT_EVENTS] = "risky drivers, no events"
    for other in [name for name in BACKENDS if name != backend]:
        physics = BACKENDS[other].removesuffix(" (replica)")
        known |= {(other, traffic): f"{traffic} traffic on {physics}" for traffic in reversed(TRAFFICS)}
    there = {*zip(rows["tested_on"], rows["traffic"], strict=True)}
    return {place: words for place, words in known.items() if place in there}


def both_arms(row: Mapping[str, Any]) -> str:
    """Control, the arm and their difference with its interval: "38.4 → 34.2", and below it "−4.2 [−7.2, −1.1]"."""
    levels = " → ".join(
        points(row[side], row["outcome"], signed=False) for side in ("mean_against", "mean_arm")
    )
    return f"{levels}\n{effect(row, row['outcome'])}"


def by_task(analysis: Analysis, backend: str, away: bool = False) -> pd.DataFrame:
    """Every task in both traffics, one below the other: in every column both arms and their difference.

    Args:
        away: instead among risky drivers that cause no events, and on other simulators.
    """
    return _lines(analysis, backend, away, {"": both_arms})


def levels(analysis: Analysis, backend: str, away: bool = False) -> pd.DataFrame:
    """The same with one number a cell, for a first look: without hard crashes, differences and intervals."""

    def mean(of: str) -> Callable[[Mapping[str, Any]], str]:
        return lambda row: points(row[of], row["outcome"], signed=False)

    cells = {", control": mean("mean_against"), ", treated": mean("mean_arm")}
    return _lines(analysis, backend, away, cells, [name for name in COLUMNS if name != "hard_crash"])


def signs(analysis: Analysis, backend: str, moments: pd.DataFrame) -> pd.DataFrame:
    """Whether treated agents have less (-) or more (+) of an outcome than control agents, or it is open (·).

    Args:
        moments: of `takeover.skill_or_caution`; it may be empty.

    Returns:
        A row a task and traffic of the simulator of the training; empty where the plan asks nothing.
    """
    home = list(places(analysis, backend))[:2]
    found: dict[tuple[str, str], dict[str, str]] = {}
    for outcome in ("crashed", "crashes_per_100_km", "mean_speed", "return"):
        for place in home:
            for side, tasks in sides(analysis, backend, outcome, place).items():
                for task in tasks:
                    found.setdefault((task, place[1]), {})[COLUMNS[outcome].label] = SIGNS[side]
    for row in moments.to_dict("records"):
        for title, question in (("in danger", "careful"), ("crashes from equal moments", "skilled")):
            text = str(row[f"who is more {question}"])
            found.setdefault((row["task"], row["traffic"]), {})[title] = SIGNS.get(text, text)
    rows = [{"task": task, "traffic": traffic, **cells} for (task, traffic), cells in found.items()]
    return in_order(pd.DataFrame(rows or {"task": []}), "task").fillna("")


def _lines(
    analysis: Analysis,
    backend: str,
    away: bool,
    cells: Mapping[str, Callable[[Mapping[str, Any]], str]],
    names: Iterable[str] = COLUMNS,
) -> pd.DataFrame:
    """A row a task and traffic with these cells of every outcome, by what they add to its title; no empty column."""
    where = places(analysis, backend)
    asked = list(where)[2:] if away else list(where)[:2]
    rows = chosen(analysis.by_task, backend=backend, scope=tasks_known())
    lines = []
    for task, own in rows.groupby("scope", sort=False):
        for simulator, traffic in asked:
            values = chosen(own, tested_on=simulator, traffic=traffic).set_index("outcome", drop=False)
            words = where[simulator, traffic].removesuffix(" traffic")
            line = {"task": task, "traffic": words if simulator == backend else f"{traffic}, {simulator}"}
            for name, (more, text) in product(names, cells.items()):
                line[titled(COLUMNS[name]) + more] = text(values.loc[name]) if name in values.index else NONE
            lines.append(line)
    frame = pd.DataFrame(lines)
    return frame.loc[:, frame.ne(NONE).any()] if lines else frame


def means_of_tasks(analysis: Analysis, backend: str) -> pd.DataFrame:
    """The difference in the crash rate as a mean over tasks, and without each task in turn."""
    where = places(analysis, backend)
    scopes = [ALL_TASKS, *(f"without {task}" for task in tasks_known())]
    rows = chosen(analysis.by_task, backend=backend, outcome="crashed", scope=scopes)
    if rows["scope"].nunique() < 3:
        return pd.DataFrame()  # of one task there is no mean
    keys = zip(rows["tested_on"], rows["traffic"], strict=True)
    rows = rows.assign(where=[where.get(key, "") for key in keys], mean=rows["scope"])
    rows = rows[rows["where"] != ""]
    order = {name: number for number, name in enumerate((*scopes, *where.values()))}
    rows = rows.sort_values(["scope", "where"], key=lambda column: column.map(order))
    return wide(rows, ["mean"], lambda row: {f"{row['where']} [points]": effect(row)})


def sides(analysis: Analysis, backend: str, outcome: str, place: tuple[str, str]) -> dict[str, list[str]]:
    """The tasks in which treated agents have "less" or "more" of an outcome than control agents, or it is "open".

    The primary outcome at home is decided with Holm's adjustment, everything else by intervals of 95 %.
    """
    found: dict[str, list[str]] = {"less": [], "more": [], "open": []}
    if place[0] == backend and place[1] in TRAFFICS and outcome in set(analysis.primary["outcome"]):
        for row in chosen(analysis.primary, backend=backend, term=place[1]).to_dict("records"):
            found[row["verdict"]].append(row["scope"])
        return found
    rows = chosen(analysis.by_task, backend=backend, scope=tasks_known(), outcome=outcome)
    rows = chosen(rows, tested_on=place[0], traffic=place[1])
    for row in rows.to_dict("records"):
        side = "less" if row["high"] < 0 else "more" if row["low"] > 0 else "open"
        found[side].append(row["scope"])
    return found


def difference(analysis: Analysis, backend: str, task: str, traffic: str) -> str:
    """Treated minus control agents' crash rate [points], tested on the simulator of the training.

    Bold where the plan decides it (Holm's correction); of traffic that it does not ask about, with a star where the
    interval excludes 0.
    """
    [row] = chosen(
        analysis.by_task, backend=backend, tested_on=backend, scope=task, traffic=traffic, outcome="crashed"
    ).to_dict("records")
    text = points(row["estimate"], "crashed")
    asked = chosen(analysis.primary, backend=backend, scope=task, term=traffic)
    if len(asked):
        return text if asked["verdict"].item() == "open" else f"**{text}**"
    return text + r"\*" * (row["low"] * row["high"] > 0)


def hopeless(analysis: Analysis, backend: str) -> dict[str, float]:
    """Settings in which every driver that does not learn crashes in at least HOPELESS of the regular episodes.

    Returns:
        The smallest share, by setting.
    """
    rows = chosen(analysis.policies, backend=backend, arm="", traffic="regular")
    smallest = rows.groupby(["task", "level_name"], sort=False)["crashed"].min()
    return {f"{task} {name}": share for (task, name), share in smallest[smallest >= HOPELESS].items()}


def failing(gates: pd.DataFrame, least: float = 2 / 3) -> dict[str, Any]:
    """Where agents fail the gates: settings in which fewer pass than `least`, and all others together.

    Args:
        gates: of the agents, as in the analysis.

    Returns:
        passed and of (all agents), named (by setting the two numbers), rest (of all other settings).
    """
    settings = gates.assign(ok=gates["passed"].eq(True)).groupby(["task", "level_name"], sort=False)
    numbers = settings["ok"].agg(["sum", "size"]).astype(int)
    few = numbers["sum"] < least * numbers["size"]
    rest = numbers[~few].sum()
    return {
        "passed": int(numbers["sum"].sum()),
        "of": len(gates),
        "named": {f"{task} {name}": tuple(row.tolist()) for (task, name), row in numbers[few].iterrows()},
        "rest": (int(rest["sum"]), int(rest["size"])),
    }
