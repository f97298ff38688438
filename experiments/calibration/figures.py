"""The dose-response curves as an SVG text."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from matplotlib.lines import Line2D

from experiments.reporting.style import INK, new_figure, styled, to_svg
from experiments.validation.checks import REFERENCE
from experiments.validation.episodes import dose

if TYPE_CHECKING:
    import pandas as pd

COLOURS = {"careful": "#009e73", "idm": "#cc79a7", "idle": "#0072b2"}
SURVIVAL = ("two-way",)  # where nearly everybody crashes, the time until then tells more


@styled
def dose_response(table: pd.DataFrame, without_events: str) -> str:
    """Crash rate (on the two-way road: length of the episode) over the dose, a column for each task."""
    lines: dict[str, Any] = {"sumo": "-", REFERENCE: "--", without_events: ":"}
    tasks = list(dict.fromkeys(table["task"]))
    figure, axes = new_figure(1, len(tasks), 2.6)
    for panel, task in zip(axes[0], tasks, strict=True):
        measure = "length" if task in SURVIVAL else "crash_rate"
        for engine, style in lines.items():
            for ego, colour in COLOURS.items():
                rows = table[(table["task"] == task) & (table["engine"] == engine) & (table["ego"] == ego)]
                panel.plot(
                    [dose(traffic) for traffic in rows["traffic"]],
                    rows[measure],
                    style,
                    color=colour,
                    marker="o",
                    ms=2.5,
                )
        panel.set_title(task)
        panel.set_ylim(bottom=0)
        panel.set_xlabel("dose")
        if task in SURVIVAL:
            panel.set_ylabel("length of the episode [s]")
    if tasks[0] not in SURVIVAL:
        axes[0, 0].set_ylabel("crash rate")
    handles = [Line2D([], [], color=colour, label=ego) for ego, colour in COLOURS.items()]
    names = ("SUMO", "highway-env", "SUMO, parameters alone")
    handles += [
        Line2D([], [], color=INK, ls=style, label=name)
        for name, style in zip(names, lines.values(), strict=True)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return to_svg(figure, "doses", "Crash rate over the dose of risk, by task, ego and simulator")
