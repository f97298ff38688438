"""The dose-response curves as an SVG text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from matplotlib.lines import Line2D

from experiments.reporting.style import CAREFUL, CONTROL, INK, VIOLET, new_figure, styled, to_svg
from experiments.validation.episodes import dose

if TYPE_CHECKING:
    import pandas as pd

COLOURS = {"careful": CAREFUL, "idm": VIOLET, "idle": CONTROL}
SURVIVAL = ("two-way",)  # where nearly everybody crashes, the time until then tells more


@styled
def dose_response(table: pd.DataFrame, engines: Sequence[str]) -> str:
    """Crash rate (on the two-way road: length of the episode) over the dose, a column for each task."""
    tasks = list(dict.fromkeys(table["task"]))
    styles = dict(zip(engines, ("-", "--", ":"), strict=True))
    figure, axes = new_figure(1, len(tasks), 2.6)
    for panel, task in zip(axes[0], tasks, strict=True):
        survival = task in SURVIVAL
        for (engine, ego), rows in table[table["task"] == task].groupby(["engine", "ego"]):
            x, y = rows["traffic"].map(dose), rows["length" if survival else "crash_rate"]
            panel.plot(x, y, styles[engine], color=COLOURS[ego], marker="o", ms=2.5)
        panel.set_title(task)
        panel.set_ylim(bottom=0)
        panel.set_xlabel("dose")
        if survival or task == tasks[0]:
            panel.set_ylabel("length of the episode [s]" if survival else "crash rate")
    handles = [Line2D([], [], color=colour, label=ego) for ego, colour in COLOURS.items()]
    handles += [Line2D([], [], color=INK, ls=style, label=engine) for engine, style in styles.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=6)
    return to_svg(figure, "doses", "Crash rate over the dose of risk, by task, ego and simulator")
