"""What a policy did in the frozen test, with intervals over scenarios: numbers, and frames of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import pandas as pd

from experiments.analysis.by_task import COLUMNS, OWN
from experiments.analysis.scores import crashes_per_100_km
from experiments.reporting.tables import NONE, chosen, points, titled
from experiments.study.compute.evaluate import limits

SETTING = ["task", "level", "traffic"]
SHOWN = {
    name: one for name, one in COLUMNS.items() if name != "score"
}  # whose marks are of the study's scenarios
ALL = "all"  # levels of a task, each alike


def rows(episodes: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """A row of a card for each task, level (ALL first) and traffic.

    Args:
        episodes: the columns of a test episode, task and level; as many of each level.

    Yields:
        task, level, traffic, episodes (their number), and of each of SHOWN the value and the ends of its 95 %
        interval; None where a task has no crossing to enter.
    """
    way = episodes.groupby(SETTING, sort=False)["distance"].transform("mean")
    ratio, factor = crashes_per_100_km(episodes, SETTING), 1e5 / way.where(way > 0)
    own = {name: kind.of for name, kind in OWN.items()}
    scored = episodes.assign(**own, crashes_per_100_km=ratio, factor=factor.fillna(0.0))
    for (task, traffic), both in scored.groupby(["task", "traffic"], sort=False):
        for level, group in ((ALL, both), *both.groupby("level", sort=False)):
            found = {
                name: limits(group[name], kind.percent)
                for name, kind in SHOWN.items()
                if group[name].notna().all()
            }
            # the wider of two intervals: the ratio's fails at few crashes, and the crash rate's by the mean way at many
            _, least, most = (group["factor"].mean() * end for end in found["crashed"])
            value, low, high = found["crashes_per_100_km"]
            found["crashes_per_100_km"] = [value, max(min(low, least), 0.0), max(high, most)]
            numbers = {name: [float(f"{one:.5g}") for one in ends] for name, ends in found.items()}
            where = {"task": task, "level": level, "traffic": traffic, "episodes": len(group)}
            yield {**where, **dict.fromkeys(SHOWN), **numbers}


def texts(cards: Mapping[str, Mapping[str, Any]], sets: Mapping[str, str]) -> pd.DataFrame:
    """The rows of the cards, with the driver's name: numbers with their intervals, "12.5 [9.1, 16.9]".

    sets: of each task that is shown what cards have to have in common.
    """
    found = [
        {"driver": driver, **{name: row[name] for name in SETTING}, "scenarios": str(row["episodes"])}
        | {titled(column): _interval(row[name], name) for name, column in SHOWN.items()}
        for driver, card in cards.items()
        for row in card["rows"]
        if card["set"].get(row["task"]) == sets.get(row["task"])
    ]
    words = {"no-events": "risky drivers, no events", "measured": "measured drivers"}
    return pd.DataFrame(found).replace({"traffic": words})


def part(frame: pd.DataFrame, **values: Any) -> pd.DataFrame:
    """The rows with these values, without the columns of these and columns in which there is no number."""
    found = chosen(frame, **values).drop(columns=list(values))
    return found.loc[:, (found != NONE).any()]


def _interval(numbers: list[float] | None, name: str) -> str:
    if numbers is None:
        return NONE
    value, low, high = (points(number, name, signed=False) for number in numbers)
    return f"{value} [{low}, {high}]"
