"""The figure of crash rates against the rate of events (`experiments/rare.py`)."""

from __future__ import annotations

import pandas as pd

from experiments.reporting.figures import CAREFUL, INK, MUTED, TREATMENT, new_figure, styled, to_svg

SHOWN = {  # column and its label, colour, and claims with which it is drawn
    "crashes_per_episode": ("all crashes", INK, ("all",)),
    "by_events_per_episode": ("crashes with an event near the ego", TREATMENT, ("all", "by events")),
}


@styled
def rare_figure(curve: pd.DataFrame, title: str) -> str:
    """Crashes per episode against the rate of events, on logarithmic axes, where they are claimed.

    The dotted line is the upper limit of crashes without an event near the ego; without a claim, a triangle is the
    upper limit of all crashes.

    curve: of `analysis.rare.curve`.
    """
    figure, [[axes]] = new_figure(1, 1, 3.6)
    for name, (label, colour, claims) in SHOWN.items():
        rows = curve[curve["claim"].isin(claims)]
        if len(rows):
            axes.fill_between(
                rows["rate"], rows[f"{name}_low"], rows[f"{name}_high"], color=colour, alpha=0.15, lw=0
            )
            axes.plot(rows["rate"], rows[name], color=colour, marker="o", label=label)
    limit = "without_per_episode_high"
    axes.plot(curve["rate"], curve[limit], color=CAREFUL, ls=":", label="limit of crashes without one")
    unclaimed = curve[curve["claim"] == "nothing"]
    if len(unclaimed):
        high = unclaimed["crashes_per_episode_high"]
        axes.plot(unclaimed["rate"], high, color=MUTED, marker="v", ls="", label="limit, nothing claimed")
    axes.set(xscale="log", yscale="log", title=title, ylabel="crashes per episode")
    axes.set_xlabel("rate of risk events (1: that at dose 1)")
    axes.legend()
    return to_svg(figure, "rare", f"Crashes per episode against the rate of risk events: {title}.")
