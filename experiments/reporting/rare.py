"""Figures of risk events: crash rates against their rate (`experiments/rare.py`), and what doses are beside roads."""

from collections.abc import Mapping
from itertools import cycle
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from experiments.reporting.figures import CAREFUL, COLOURS, INK, MUTED, TASKS, larger, legend, to_svg

SHOWN = {  # column, how it is drawn, and the claim with which it is
    "crashes": ("crashes_per_episode", "-", "all"),
    "crashes with an event near the ego": ("by_events_per_episode", "--", "by events"),
}
PALETTE = (CAREFUL, "#8a3a8f", "#a87400", INK)  # of policies that are not the first of an arm, in their order
# Of the 100-Car study: 2,000,000 vehicle miles in 43,000 hours (Neale et al. 2005).
MILES_PER_HOUR = 2.0e6 / 43_000
LANE_CHANGES = "lane changes ahead of others on roads"
ROADS = {  # events per vehicle and hour of driving, and their mark (docs/traffic-and-risk.md)
    # SHRP 2, drivers of 35 to 54 years: 37.3 in a million miles (Traffic Inj. Prev. 19 S1, 2018, S89 [abstract])
    "near-crashes on roads": (37.3e-6 * MILES_PER_HOUR, "^"),
    # highD: 110,500 vehicles, 13.6 s of each in view (Krajewski et al. 2018); 3,787 lane changes ahead of a vehicle, of
    # which cut-ins are a part ("Why studying cut-ins? Comparing cut-ins and other lane changes" [a summary])
    LANE_CHANGES: (3_787 / (110_500 * 13.6 / 3600), "s"),
}
PANELS = {
    "braking_4.4": "hard braking [1/min]",
    "cut_ins": "forced cut-ins [1/min]",
    "headway": "median headway [s]",
}
MEASURED = 1.5  # where measured drivers stand on the axis of doses


@larger
def rare_figure(curves: Mapping[str, pd.DataFrame], title: str) -> str:
    """Crashes per episode of each policy against the rate of events, on logarithmic axes, with ROADS as marks on one.

    A curve is drawn where it is claimed, without a claim a triangle at the upper limit of all crashes. The dotted line
    is the upper limit of crashes without an event near the ego.

    curves: of `analysis.rare.curve` with events_per_hour, by policy.
    """
    figure = Figure(figsize=(6.5, 5.6), layout="constrained")
    axes = figure.subplots()
    looks: dict[str, dict[str, Any]] = {}
    arms, others = dict(COLOURS), cycle(PALETTE)
    for policy, curve in curves.items():
        colour = arms.pop(policy.rpartition("/")[2], None) or next(others)
        looks[policy] = {"color": colour}
        for name, style, claim in SHOWN.values():
            rows = curve[curve["claim"] == claim]
            band = rows["events_per_hour"], rows[f"{name}_low"], rows[f"{name}_high"]
            axes.fill_between(*band, color=colour, alpha=0.15, lw=0)
            axes.plot(rows["events_per_hour"], rows[name], color=colour, marker="o", ms=3, ls=style)
        unclaimed = curve[curve["claim"] == "nothing"]
        high = unclaimed["crashes_per_episode_high"]
        axes.plot(unclaimed["events_per_hour"], high, color=colour, marker="v", ls="")
        limit = curve["without_per_episode_high"]
        axes.plot(curve["events_per_hour"], limit, color=colour, ls=":", lw=1.0)
    claims = set(pd.concat([*curves.values()])["claim"])
    styles = {label: style for label, (_, style, claim) in SHOWN.items() if claim in claims}
    looks |= {label: {"color": MUTED, "ls": style} for label, style in styles.items()}
    looks["limit of crashes without one"] = {"color": MUTED, "ls": ":"}
    looks["limit, nothing claimed"] = {"color": MUTED, "ls": "", "marker": "v"}
    for label, (rate, mark) in ROADS.items():
        on_axis: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "clip_on": False}
        looks[label] = {"color": INK, "marker": mark, "ls": ""}
        axes.plot([rate], [0.0], **looks[label], **on_axis)
    axes.set(xscale="log", yscale="log", title=title, ylabel="crashes per episode")
    axes.set_xlabel("risk events per vehicle and hour")
    legend(figure, looks, loc="outside lower center", ncols=2)
    return to_svg(figure, "rare", f"Crashes per episode against the rate of risk events: {title}.")


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
    looks = {task: {"color": TASKS[task], "marker": "o", "ms": 4} for task in table["task"].unique()}
    looks["measured drivers"] = {"color": MUTED, "marker": "D", "mfc": "none", "ls": ""}
    looks[LANE_CHANGES.replace(" ahead", "\nahead")] = {"color": INK, "marker": "s", "ls": ""}
    spare.set_axis_off()
    legend(spare, looks, loc="center")
    figure.supxlabel("dose of risk", fontsize=11)
    return to_svg(
        figure, "doses", "Hard braking, cut-ins and headway by dose of risk, beside measured drivers"
    )
