"""The checks of SUMO against highway-env as one figure."""

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from experiments.reporting.figures import GRID, INK, MUTED, TASKS, TREATMENT, larger, legend, to_svg
from experiments.validation.checks import MARGINS

# Panels: metrics, title with the margin, whether values are shares of the return's range, and whether the margin is a
# share of highway-env's value.
SCATTERS = (
    (("crashed", "crashed_ego"), "crash rate (± 0.15)", False, False),
    (("return",), "return, share of its range (± 0.05)", True, False),
    (("traffic_speed",), "speed of traffic [m/s] (± 5 %)", False, True),
)
WIDEST, BARS = 1.5, 15  # of the histogram, in margins, and its bars


@larger
def validation_figure(checks: pd.DataFrame) -> str:
    """SUMO against highway-env with the margins, and how far all checks are from them.

    checks: those of `scorecard` with a verdict; orders of egos are not drawn.
    """
    rows = checks[checks["metric"] != "order"]
    scale = rows["margin"] / MARGINS["return"][0]
    with matplotlib.rc_context({"axes.titlesize": 10}):
        figure = Figure(figsize=(6.5, 6.2), layout="constrained")
        *scatters, whole = figure.subplots(2, 2).ravel()
        for panel, (metrics, title, of_range, relative) in zip(scatters, SCATTERS, strict=True):
            own = rows[rows["metric"].isin(metrics)]
            x, y = (own[side] / (scale[own.index] if of_range else 1.0) for side in ("reference", "sumo"))
            ends = np.array([min(x.min(), y.min(), 0.0), max(x.max(), y.max())])
            width = MARGINS[metrics[-1]][0] * (ends if relative else np.ones(2))
            panel.fill_between(ends, ends - width, ends + width, color=GRID, lw=0)
            panel.plot(ends, ends, color=MUTED, lw=0.8)
            panel.scatter(x, y, s=14, color=own["task"].map(TASKS), alpha=0.7, lw=0)
            panel.set(title=title, box_aspect=1, xlabel="highway-env", ylabel="SUMO")
        share = (rows["difference"].abs() / rows["margin"]).clip(upper=WIDEST)
        counts, edges = np.histogram(share, BARS, (0.0, WIDEST))
        colours = np.where(edges[:-1] < 1.0 - 1e-9, INK, TREATMENT)
        whole.bar(edges[:-1], counts, WIDEST / BARS, align="edge", color=colours)
        whole.axvline(1.0, color=MUTED)
        whole.set(title="all by size", box_aspect=1, xlabel="difference, in margins", ylabel="checks")
        looks = {task: {"ls": "", "marker": "o", "color": TASKS[task]} for task in rows["task"].unique()}
        legend(figure, looks, ncols=5, handletextpad=0.0, columnspacing=0.8)
        return to_svg(figure, "validation", "Checks of SUMO against highway-env, with their margins")
