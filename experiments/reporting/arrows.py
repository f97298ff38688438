"""Figures with an arrow for each task, from control to treated agents: what the study found, at a look."""

from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.patheffects import withStroke
from matplotlib.textpath import TextPath
from numpy.typing import NDArray

from experiments.reporting.figures import INK, MARKS, PAPER, TASKS, larger, legend, share_axis, to_svg
from experiments.study.design.arms import ARMS
from experiments.study.design.traffic import TRAFFICS

TREATED = ("control agents", "treated agents")
BESIDE = {"sumo": "SUMO's driver", "planner": "planner", "slower": "always SLOWER"}  # agents, and their names
HALO = [withStroke(linewidth=2.5, foreground=PAPER)]  # around words that stand on lines
# What a name takes in `arrows`, as a share of the axes: a line's height, and a point of its width.
LINE, POINT = 0.062, 0.0052


@larger
def crashes_against_speed(drivers: pd.DataFrame, name: str) -> str:
    """Crash rate against speed, an arrow from control to treated agents for each task, one panel for each traffic.

    drivers: of `analysis.drivers`, one setting of each task, with both arms. name: of the figure's ids.
    """
    figure, panels = arrows(drivers, 4.6, "mean_speed", 33.0)
    panels[0].set_xticks([0, 10, 20, 30])
    panels[0].set_ylabel("episodes with a crash")
    figure.supxlabel("mean speed [m/s]", fontsize=11)
    return to_svg(figure, f"{name}-speed", f"Crash rate against speed, from {TREATED[0]} to {TREATED[1]}")


def arrows(drivers: pd.DataFrame, height: float, x: str, right: float) -> tuple[Figure, Any]:
    """A figure with a panel for each traffic, in which an arrow of each task leads from control to treated agents.

    x: the horizontal outcome. right: end of its axis.
    """
    figure = Figure(figsize=(6.5, height), layout="constrained")
    panels = figure.subplots(1, len(TRAFFICS), sharex=True, sharey=True)
    for panel, traffic in zip(panels, TRAFFICS, strict=True):
        there = drivers[drivers["traffic"] == traffic]
        for task, own in there.groupby("task", sort=False):
            _task(panel, str(task), own.set_index("driver"), x, right)
        _names(panel, there, x, right)
        panel.set(title=f"in {traffic} traffic", xlim=(-0.03 * right, right))
        share_axis(panel)
    marks = {TREATED[0]: ("o", PAPER), TREATED[1]: ("o", INK)}
    marks |= {words: (MARKS[who], "none") for who, words in BESIDE.items() if who in set(drivers["driver"])}
    looks = {words: {"color": INK, "ls": "", "marker": m, "mfc": c} for words, (m, c) in marks.items()}
    legend(figure, looks, ncols=3, handletextpad=0.1)
    return figure, panels


def _names(panel: Axes, drivers: pd.DataFrame, x: str, right: float) -> None:
    """Each task's name beside its arrow, where it covers least of names, marks and arrows."""
    places = drivers.set_index(["task", "driver"])[[x, "crashed"]] / [right, 1.0]
    tasks = list(drivers["task"].unique())
    arms = places.index.get_level_values("driver").isin(ARMS)
    ends = {task: [places.loc[(task, arm)].to_numpy() for arm in ARMS] for task in tasks}
    ways = [np.linspace(start, end, 20) for start, end in ends.values()]
    seen = np.concatenate([places, *ways])
    matters = np.concatenate([np.where(arms, 4.0, 1.0), np.full(20 * len(tasks), 0.4)])
    bold = FontProperties(weight="bold")
    widths = [TextPath((0, 0), task, 10, prop=bold).get_extents().width for task in tasks]
    half = {task: np.array([POINT * width, LINE]) / 2 for task, width in zip(tasks, widths, strict=True)}
    middles: dict[str, NDArray[np.float64]] = {}

    def cost(task: str, shift: NDArray[np.float64], middle: NDArray[np.float64]) -> float:
        covered = (np.abs(seen - middle) < half[task] + 0.02).all(axis=1)
        others = (name for name in middles if name != task)
        names = sum((np.abs(middle - middles[name]) < half[task] + half[name]).all() for name in others)
        outside = (middle < half[task]).any() or middle[0] > 1 - half[task][0] or middle[1] > 1.04
        far = (np.abs(shift) - half[task]).clip(0.0).sum()
        # rounded, so that processors agree on what is equal
        return round(float(matters[covered].sum() + 50 * (names + outside) + 12 * far), 6)

    for task in tasks * 3:  # each again, once the others have their places
        steps = product(np.linspace(-1, 1, 7) * (half[task][0] + 0.04), np.arange(-5, 6) * LINE)
        shifts = [np.array(step) for step in steps if step[1] or abs(step[0]) > half[task][0]]
        found = [(shift, end + shift) for end, shift in product(ends[task], shifts)]
        middles[task] = min(found, key=lambda one: cost(task, *one))[1]
    for task, middle in middles.items():
        words: dict[str, Any] = {"color": TASKS.get(task, INK), "fontweight": "bold", "fontsize": 10}
        at = middle[0] * right, middle[1]
        panel.text(*at, task, ha="center", va="center", zorder=5, path_effects=HALO, **words)


def _task(panel: Axes, task: str, drivers: pd.DataFrame, x: str, right: float) -> None:
    """The drivers of a task in one traffic, by name. x: the horizontal outcome. right: end of its axis."""
    colour = TASKS.get(task, INK)
    for name in BESIDE:
        if name in drivers.index:
            place = drivers.loc[name, [x, "crashed"]]
            panel.plot(*place, MARKS[name], color=colour, mfc="none", ms=6, clip_on=False)
    start, end = (drivers.loc[arm] for arm in ARMS)
    for row, fill in ((start, PAPER), (end, colour)):
        ends: dict[str, Any] = {
            axis: [[row[name] - row[f"{name}_low"]], [row[f"{name}_high"] - row[name]]]
            for axis, name in (("xerr", x), ("yerr", "crashed"))
        }
        form: dict[str, Any] = {"color": colour, "mfc": fill, "ms": 7, "mew": 1.6, "clip_on": False}
        panel.errorbar(row[x], row["crashed"], fmt="o", zorder=4, **ends, **form)
    goal, origin = ((row[x], row["crashed"]) for row in (end, start))
    way = np.hypot((goal[0] - origin[0]) / right, goal[1] - origin[1])
    if way > 0.05:  # else the head of the arrow is longer than it
        arrow: dict[str, Any] = {"arrowstyle": "-|>", "color": colour, "lw": 2, "shrinkA": 0, "shrinkB": 3}
        panel.annotate("", goal, origin, arrowprops=arrow, zorder=3)
