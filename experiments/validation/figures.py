"""The figures of validation.html: each a pure function of the results that returns an SVG text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from experiments.reporting.style import CONTROL, GRID, INK, MUTED, TREATMENT, new_figure, styled, to_svg
from experiments.validation.checks import REFERENCE
from experiments.validation.episodes import BIN, BINS, HEADWAYS

if TYPE_CHECKING:
    import pandas as pd

OWN, THEIRS = TREATMENT, CONTROL
MARKS = {
    "idle": "o",
    "random": "D",
    "faster": "^",
    "slower": "v",
    "idm": "s",
    "careful": "*",
    "pulsing": "P",
    "weaving": "X",
}
ROWS = (
    ("traffic_speed", "traffic speed"), ("headway", "headways"), ("return", "return"), ("crashed", "crash rate"),
    ("crashed_ego", "crash rate of each ego"), ("lane_changes", "lane changes"),
)  # fmt: skip
OUTCOMES = ("crashed", "arrived", "time", "left")


def _style(own: bool) -> dict[str, Any]:
    """highway-env broad below, SUMO thin above: where only one line is seen, both agree."""
    return {"color": OWN, "lw": 1.2} if own else {"color": THEIRS, "lw": 2.8, "alpha": 0.5}


def _legend(figure: Any, own: str) -> None:
    keys = [Line2D([], [], label="highway-env", **_style(False)), Line2D([], [], label=own, **_style(True))]
    figure.legend(handles=keys, loc="outside upper right", ncols=2)


@styled
def overview(tasks: Mapping[str, Any], traffic: str) -> str:
    """Every check with a margin: its difference as a share of the margin, with interval."""
    figure, axes = new_figure(1, len(tasks), 4.6, sharey=True, sharex=True)
    for panel, (task, result) in zip(axes[0], tasks.items(), strict=True):
        panel.axvspan(-1, 1, color=GRID, alpha=0.6, lw=0)
        panel.axvline(0, color=INK, lw=0.8)
        panel.set_title(task)
        levels = result["traffics"].get(traffic, {})
        for number, checks in enumerate(levels.values()):
            shift = 0.3 - 0.6 * number / max(len(levels) - 1, 1)
            for row, (metric, _) in enumerate(ROWS):
                shown = [
                    item for item in checks if item["metric"] == metric and item["margin"] and item["verdict"]
                ]
                for place, item in enumerate(shown):  # several only where each ego has its own
                    aside = 0.2 * (place / max(len(shown) - 1, 1) - 0.5) if len(shown) > 1 else 0.0
                    _share(panel, item, -row + shift - aside)
        panel.grid(axis="y", visible=False)
        panel.set_xlim(-2.2, 2.2)
    axes[0, 0].set_yticks([-row for row in range(len(ROWS))], [label for _, label in ROWS])
    figure.supxlabel(
        "difference as a share of its margin, a line for each level (filled: equivalent)", fontsize=8.5
    )
    return to_svg(figure, f"overview-{traffic}", f"All checks in {traffic} traffic: difference over margin")


def _share(panel: Any, item: Mapping[str, Any], y: float) -> None:
    colour = OWN if item["verdict"] == "missed" else THEIRS
    if item["low"] is not None:
        ends = np.array([item["low"], item["high"]]) / item["margin"]
        panel.plot(np.clip(ends, -2.2, 2.2), [y, y], color=colour, lw=0.9)
    fill = {} if item["verdict"] == "equivalent" else {"mfc": "white"}
    share = float(np.clip(item["difference"] / item["margin"], -2.2, 2.2))
    panel.plot(share, y, "o", color=colour, ms=3.2, mew=0.9, **fill)


@styled
def distributions(table: pd.DataFrame, own: str, task: str, names: Sequence[str]) -> str:
    """Headways, traffic speed and return of a task's episodes in regular traffic, a row for each level."""
    rows = table[(table["task"] == task) & (table["traffic"] == "regular")]
    levels = sorted(set(rows["level"]))
    figure, axes = new_figure(len(levels), 3, 0.8 + 1.3 * len(levels), sharex="col")
    for number, level in enumerate(levels):
        for engine in (REFERENCE, own):
            part = rows[(rows["level"] == level) & (rows["engine"] == engine)]
            counts = part[HEADWAYS].to_numpy(float).sum(axis=0)
            style = _style(engine == own)
            axes[number, 0].stairs(counts / max(counts.sum(), 1), np.arange(BINS + 1) * BIN, **style)
            for column, measure in ((1, "traffic_speed"), (2, "return")):
                values = np.sort(part[measure].dropna().to_numpy(float))
                shares = np.arange(1, len(values) + 1) / max(len(values), 1)
                axes[number, column].step(values, shares, **style)
        axes[number, 0].set_ylabel(names[level - 1])
        axes[number, 0].set_yticklabels([])
    for column, title in enumerate(
        ("headways (shares)", "traffic speed (cumulative)", "return (cumulative)")
    ):
        axes[0, column].set_title(title)
    for column, unit in enumerate(("[s]", "mean of an episode [m/s]", "of an episode")):
        axes[-1, column].set_xlabel(unit)
    _legend(figure, own)
    return to_svg(figure, f"distributions-{task}", f"Distributions of headway, speed and return on {task}")


@styled
def survival(table: pd.DataFrame, own: str, tasks: Sequence[str]) -> str:
    """Share of the episodes without a crash so far, all levels and egos, in both traffics."""
    traffics = list(dict.fromkeys(table["traffic"]))
    figure, axes = new_figure(len(traffics), len(tasks), 0.8 + 1.4 * len(traffics), sharey=True, sharex="col")
    for row, traffic in enumerate(traffics):
        for column, task in enumerate(tasks):
            for engine in (REFERENCE, own):
                part = table[
                    (table["task"] == task) & (table["traffic"] == traffic) & (table["engine"] == engine)
                ]
                times = np.sort(part["crash_time"].dropna().to_numpy(float))
                left = 1.0 - np.arange(len(times) + 1) / max(len(part), 1)
                axes[row, column].step(np.append(0.0, times), left, where="post", **_style(engine == own))
            axes[row, column].set_ylim(0, 1.02)
            axes[row, column].set_xlim(left=0)
            if row == 0:
                axes[row, column].set_title(task)
        axes[row, 0].set_ylabel(f"{traffic}:\nshare not crashed")
    for panel in axes[-1]:
        panel.set_xlabel("time [s]")
    _legend(figure, own)
    return to_svg(figure, "survival", "Share of the episodes that have not crashed yet over time")


@styled
def egos(table: pd.DataFrame, own: str, tasks: Sequence[str], traffic: str) -> str:
    """Return and crash rate of every ego at every level, one simulator against the other."""
    rows = table[(table["traffic"] == traffic) & table["engine"].isin((own, REFERENCE))].astype(
        {"crashed": float}
    )
    figure, axes = new_figure(2, len(tasks), 3.8)
    for column, task in enumerate(tasks):
        for row, measure in enumerate(("return", "crashed")):
            panel = axes[row, column]
            part = rows[rows["task"] == task]
            means = part.groupby(["engine", "level", "ego"])[measure].mean().unstack("engine").dropna()
            for ego in dict.fromkeys(means.index.get_level_values("ego")):
                chosen = means.xs(ego, level="ego")
                panel.plot(chosen[REFERENCE], chosen[own], MARKS[ego], color=OWN, ms=4, alpha=0.8, mew=0.4)
            values = means.to_numpy()
            low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 1.0)
            panel.axline((low, low), (high, high + 1e-9), color=MUTED, lw=0.8)
            panel.set_aspect("equal", adjustable="datalim")
        axes[0, column].set_title(task)
    axes[0, 0].set_ylabel(f"return, {own}")
    axes[1, 0].set_ylabel(f"crash rate, {own}")
    for panel in axes[1]:
        panel.set_xlabel("highway-env")
    handles = [
        Line2D([], [], color=OWN, ls="", marker=mark, ms=4, label=name) for name, mark in MARKS.items()
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=8)
    return to_svg(figure, f"egos-{traffic}", f"Return and crash rate of all egos in {traffic} traffic")


@styled
def fundamental(table: pd.DataFrame, own: str) -> str:
    """Flow and speed against density on the highway, a point for each episode."""
    figure, axes = new_figure(1, 2, 2.7)
    rows = table[(table["task"] == "highway") & (table["traffic"] == "regular")]
    for engine, marker, size in ((REFERENCE, "o", 16), (own, "x", 9)):
        part = rows[rows["engine"] == engine]
        style: Any = {
            "s": size,
            "marker": marker,
            "c": OWN if engine == own else THEIRS,
            "alpha": 0.5,
            "lw": 0.7,
        }
        axes[0, 0].scatter(part["ahead"], part["flow"], **style)
        axes[0, 1].scatter(part["ahead"], part["traffic_speed"], **style)
    axes[0, 0].set_ylabel("flow, four lanes [vehicles/h]")
    axes[0, 1].set_ylabel("speed [m/s]")
    for panel in axes[0]:
        panel.set_xlabel("density, 200 m ahead of the ego [vehicles/km]")
    _legend(figure, own)
    return to_svg(figure, "fundamental", "Fundamental diagram of the highway")


@styled
def outcomes(table: pd.DataFrame, own: str, tasks: Sequence[str]) -> str:
    """How pairs of episodes end: a column for highway-env's ending, its parts by the other simulator's."""
    from experiments.validation.compare import pairs

    both = pairs(table[table["traffic"] == "regular"], own, REFERENCE)
    figure, axes = new_figure(1, len(tasks), 2.4, sharey=True)
    colours = {"crashed": OWN, "arrived": "#009e73", "time": THEIRS, "left": MUTED}
    for panel, task in zip(axes[0], tasks, strict=True):
        part = both[both["task"] == task]
        for place, theirs in enumerate(OUTCOMES):
            column, bottom = part[part["outcome_b"] == theirs], 0.0
            for ours in OUTCOMES:
                share = float((column["outcome_a"] == ours).sum() / max(len(part), 1))
                panel.bar(place, share, bottom=bottom, color=colours[ours], width=0.7)
                bottom += share
        panel.set_xticks(range(len(OUTCOMES)), OUTCOMES, rotation=45, ha="right", fontsize=7)
        panel.set_title(task)
        panel.grid(axis="x", visible=False)
    axes[0, 0].set_ylabel("share of the pairs")
    handles = [Line2D([], [], color=colour, lw=5, label=f"{own}: {name}") for name, colour in colours.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return to_svg(figure, "outcomes", "How pairs of episodes end in the two simulators")
