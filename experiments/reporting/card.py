"""What a policy did in the frozen test, with intervals over scenarios: numbers, frames of text, and a figure."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from experiments.analysis.by_task import COLUMNS, OWN
from experiments.analysis.scores import per_metre
from experiments.reporting import figures
from experiments.reporting.tables import NONE, chosen, points, titled
from experiments.study.compute.evaluate import limits

SETTING = ["task", "level", "traffic"]
# Without the score, whose marks are of the study's scenarios.
SHOWN = {name: one for name, one in COLUMNS.items() if name != "score"}
ALL = "all"  # levels of a task, each alike
TRAINED = "phdH<>"  # marks of trained policies that are of no arm
AXES = ("mean_speed", "crashed")  # of the figure
Cards = Mapping[str, Mapping[str, Any]]


def rows(episodes: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """A row of a card for each task, level (ALL first) and traffic.

    Args:
        episodes: the columns of a test episode, task and level; as many of each level.

    Yields:
        task, level, traffic, episodes (their number), and of each of SHOWN the value and the ends of its 95 %
        interval; None where a task has no crossing to enter.
    """
    way = episodes.groupby(SETTING, sort=False)["distance"].transform("mean")
    ratio, factor = 1e5 * per_metre(episodes, "crashed", SETTING), 1e5 / way.where(way > 0)
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


def _compared(cards: Cards, sets: Mapping[str, str]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The driver's name and each row of the cards whose task is of the same set of scenarios."""
    for driver, card in cards.items():
        for row in card["rows"]:
            if card["set"].get(row["task"]) == sets.get(row["task"]):
                yield driver, row


def texts(cards: Cards, sets: Mapping[str, str]) -> pd.DataFrame:
    """The rows of the cards, with the driver's name: numbers with their intervals, "12.5 [9.1, 16.9]".

    sets: of each task that is shown what cards have to have in common.
    """
    found = [
        {"driver": driver, **{name: row[name] for name in SETTING}, "scenarios": str(row["episodes"])}
        | {titled(column): _interval(row[name], name) for name, column in SHOWN.items()}
        for driver, row in _compared(cards, sets)
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


def _looks(drivers: list[str], own: str) -> dict[str, dict[str, Any]]:
    """How each driver is drawn: one's own in ink, agents of the study in their colours, others that learned filled."""
    found, marks = dict[str, dict[str, Any]](), iter(TRAINED * len(drivers))
    for name in drivers:
        if name == own:
            found[name] = {"marker": "D", "color": figures.INK, "ms": 8, "lw": 2.5, "zorder": 5}
        elif name in figures.COLOURS:
            found[name] = {"marker": "o", "color": figures.COLOURS[name], "ms": 6, "lw": 1.2}
        elif name in figures.MARKS or name.startswith("careful"):
            found[name] = {**figures.mark_of(name), "ms": 9 if name == "careful" else 6, "lw": 1.2}
        else:
            found[name] = {"marker": next(marks), "color": figures.MUTED, "ms": 6, "lw": 1.2}
    return found


@figures.larger
def card_figure(cards: Cards, sets: Mapping[str, str], own: str = "") -> str | None:
    """Crash rate against speed, a panel for each task: lines lead from regular to risky traffic, where the marks are.

    None where no driver has both. own: the driver that stands out, with its 95 % intervals in risky traffic.
    """
    rows = {
        (row["task"], driver, row["traffic"]): row
        for driver, row in _compared(cards, sets)
        if row["level"] == ALL
    }
    driven = [key[:2] for key in rows if key[2] == "risky" and (*key[:2], "regular") in rows]
    if not driven:
        return None
    tasks = list(dict.fromkeys(task for task, _ in driven))
    looks = _looks(list(dict.fromkeys(driver for _, driver in driven)), own)
    figure, panels, show = _panels(len(tasks))
    for task, driver in driven:
        both = [rows[task, driver, traffic] for traffic in ("regular", "risky")]
        _drive(panels[tasks.index(task)], both, looks[driver], bars=driver == own)
    for task, panel in zip(tasks, panels, strict=False):
        panel.set_title(task)
        panel.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        figures.share_axis(panel)
    show(looks, title="a line begins in regular traffic,\nits mark is in risky traffic")
    figure.supxlabel("mean speed [m/s]", fontsize=11)
    figure.supylabel("episodes with a crash", fontsize=11)
    return figures.to_svg(figure, "card", "Crash rate against speed by task, from regular to risky traffic")


def _panels(count: int) -> tuple[Figure, list[Axes], Callable[..., Any]]:
    """A figure with at least so many panels, and what draws its legend: where a panel is to spare, or above all."""
    rows, columns = -(-count // 2), min(count, 2)
    spare = count < rows * columns
    figure = Figure(figsize=(6.5, 2.1 * rows + (0.5 if spare else 1.6)), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True).ravel().tolist()
    if not spare:
        return figure, panels, partial(figures.legend, figure, ncols=4)
    panels[-1].set_axis_off()
    return figure, panels, partial(figures.legend, panels[-1], loc="center", ncols=2)


def _drive(panel: Axes, rows: list[Mapping[str, Any]], look: Mapping[str, Any], bars: bool) -> None:
    """A driver's way from row to row, with a mark on the last one, there with its intervals if bars are asked for."""
    panel.plot(*([row[name][0] for row in rows] for name in AXES), markevery=[-1], clip_on=False, **look)
    if bars:
        (x, *across), (y, *along) = (rows[-1][name] for name in AXES)
        panel.plot([*across, x, x, x], [y, y, y, *along], color=figures.INK, lw=1.2)
