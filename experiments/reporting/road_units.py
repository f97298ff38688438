"""The figure of doses of risk beside measured drivers (`docs/road_units.py` makes its table)."""

from __future__ import annotations

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.reporting.figures import INK, MUTED, TASKS, larger, to_svg
from experiments.reporting.rare import LANE_CHANGES, ROADS

PANELS = {
    "braking_4.4": "hard braking [1/min]",
    "cut_ins": "forced cut-ins [1/min]",
    "headway": "median headway [s]",
}
MEASURED = 1.5  # where measured drivers stand on the axis of doses


@larger
def doses_figure(table: pd.DataFrame) -> str:
    """Hard braking and cut-ins per vehicle and minute, and the headway, by dose and among measured drivers.

    Tasks without cut-ins have none drawn; beside the others' stands the rate of ROADS.

    table: a row a task and traffic (a dose, or "measured"), with the columns PANELS.
    """
    figure = Figure(figsize=(6.5, 5.0), layout="constrained")
    *panels, spare = figure.subplots(2, 2).ravel()
    for panel, (unit, title) in zip(panels, PANELS.items(), strict=True):
        for task, own in table.groupby("task", sort=False):
            values = own.set_index("traffic")[unit]
            measured = values.pop("measured")
            if values.any():
                panel.plot(
                    values.index.astype(float), values, color=TASKS[task], marker="o", ms=4, clip_on=False
                )
            if unit != "cut_ins":  # which these drivers never force
                panel.plot([MEASURED], [measured], color=TASKS[task], marker="D", mfc="none", clip_on=False)
        panel.set(title=title, ylim=(0, None), xlim=(-0.1, MEASURED + 0.3))
        panel.set_xticks([0, 0.5, 1, MEASURED], ["0", "0.5", "1", "measured"])
    panels[1].plot([MEASURED], [ROADS[LANE_CHANGES][0] / 60], color=INK, marker="s", ls="")
    handles = [
        Line2D([], [], color=TASKS[task], marker="o", ms=4, label=task) for task in table["task"].unique()
    ]
    handles += [
        Line2D([], [], color=MUTED, marker="D", mfc="none", ls="", label="measured drivers"),
        Line2D([], [], color=INK, marker="s", ls="", label=LANE_CHANGES.replace(" ahead", "\nahead")),
    ]
    spare.set_axis_off()
    spare.legend(handles=handles, loc="center")
    figure.supxlabel("dose of risk", fontsize=11)
    return to_svg(
        figure, "doses", "Hard braking, cut-ins and headway by dose of risk, beside measured drivers"
    )
