"""The figures of validation.html: each a pure function of the results that returns an SVG text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.lines import Line2D

from experiments.reporting.style import CONTROL, GRID, INK, TREATMENT, new_figure, styled, to_svg
from experiments.validation.checks import REFERENCE
from experiments.validation.episodes import BIN, BINS, HEADWAYS

if TYPE_CHECKING:
    import pandas as pd

OWN, THEIRS = TREATMENT, CONTROL
FARTHEST = 2.2  # margins; what lies beyond is drawn at the edge
ROWS = {
    "traffic_speed": "traffic speed",
    "headway": "headways",
    "return": "return",
    "crashed": "crash rate",
    "crashed_ego": "crash rate of each ego",
    "lane_changes": "lane changes",
}


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
            for row, metric in enumerate(ROWS):
                shown = [c for c in checks if c["metric"] == metric and c["margin"] and c["verdict"]]
                for place, item in enumerate(shown):  # several only where each ego has its own
                    aside = 0.2 * (place / max(len(shown) - 1, 1) - 0.5) if len(shown) > 1 else 0.0
                    _share(panel, item, -row + shift - aside)
        panel.grid(axis="y", visible=False)
        panel.set_xlim(-FARTHEST, FARTHEST)
    axes[0, 0].set_yticks([-row for row in range(len(ROWS))], list(ROWS.values()))
    words = "difference as a share of its margin, a line for each level (filled: equivalent)"
    figure.supxlabel(words, fontsize=8.5)
    return to_svg(figure, f"overview-{traffic}", f"All checks in {traffic} traffic: difference over margin")


def _share(panel: Any, item: Mapping[str, Any], y: float) -> None:
    colour = OWN if item["verdict"] == "missed" else THEIRS
    if item["low"] is not None:
        ends = np.array([item["low"], item["high"]]) / item["margin"]
        panel.plot(np.clip(ends, -FARTHEST, FARTHEST), [y, y], color=colour, lw=0.9)
    fill = {} if item["verdict"] == "equivalent" else {"mfc": "white"}
    share = float(np.clip(item["difference"] / item["margin"], -FARTHEST, FARTHEST))
    panel.plot(share, y, "o", color=colour, ms=3.2, mew=0.9, **fill)


@styled
def distributions(table: pd.DataFrame, own: str, task: str, names: Sequence[str]) -> str:
    """Headways, traffic speed and return of a task's episodes in regular traffic, a row for each level.

    highway-env is broad and below, the other simulator thin and above: where only one line is seen, both agree.
    """
    styles: dict[str, Any] = {
        REFERENCE: {"color": THEIRS, "lw": 2.8, "alpha": 0.5, "label": "highway-env"},
        own: {"color": OWN, "lw": 1.2, "label": own},
    }
    rows = table[(table["task"] == task) & (table["traffic"] == "regular")]
    levels = sorted(set(rows["level"]))
    figure, axes = new_figure(max(len(levels), 1), 3, 0.8 + 1.3 * len(levels), sharex="col")
    for number, level in enumerate(levels):
        for engine, style in styles.items():
            part = rows[(rows["level"] == level) & (rows["engine"] == engine)]
            counts = part[HEADWAYS].to_numpy(float).sum(axis=0)
            axes[number, 0].stairs(counts / max(counts.sum(), 1), np.arange(BINS + 1) * BIN, **style)
            for column, measure in ((1, "traffic_speed"), (2, "return")):
                values = np.sort(part[measure].dropna().to_numpy(float))
                axes[number, column].step(
                    values, np.arange(1, len(values) + 1) / max(len(values), 1), **style
                )
        axes[number, 0].set_ylabel(names[level - 1])
        axes[number, 0].set_yticklabels([])
    titles = ("headways (shares)", "traffic speed (cumulative)", "return (cumulative)")
    units = ("[s]", "mean of an episode [m/s]", "of an episode")
    for column, (title, unit) in enumerate(zip(titles, units, strict=True)):
        axes[0, column].set_title(title)
        axes[-1, column].set_xlabel(unit)
    figure.legend(handles=[Line2D([], [], **s) for s in styles.values()], loc="outside upper right", ncols=2)
    return to_svg(figure, f"distributions-{task}", f"Distributions of headway, speed and return on {task}")
