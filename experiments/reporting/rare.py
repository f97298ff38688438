"""Figures of crash rates against the rate of events (`experiments/rare.py`, `experiments/break_even.py`)."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from experiments.analysis.break_even import BreakEven
from experiments.analysis.rare import ENDS
from experiments.reporting.figures import (
    CAREFUL,
    COLOURS,
    INK,
    MUTED,
    TREATMENT,
    by_task,
    new_figure,
    styled,
    to_svg,
)
from experiments.study.design.arms import ARMS

BREAK_EVEN = "break-even"  # files of `break_even.py`, and their folder beside a report
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


# Of the 100-Car study: 2,000,000 vehicle miles in 43,000 hours (Neale et al. 2005).
MILES_PER_HOUR = 2.0e6 / 43_000
ROADS = {  # events per vehicle and hour of driving, and how their line is drawn
    # SHRP 2, drivers of 35 to 54 years: 37.3 in a million miles (Traffic Inj. Prev. 19 S1, 2018, S89 [abstract])
    "near-crashes": (37.3e-6 * MILES_PER_HOUR, ":"),
    # highD: 110,500 vehicles, 13.6 s of each in view (Krajewski et al. 2018); 3,787 lane changes ahead of a vehicle, of
    # which cut-ins are a part ("Why studying cut-ins? Comparing cut-ins and other lane changes" [a summary])
    "lane changes ahead of others": (3_787 / (110_500 * 13.6 / 3600), "--"),
}


def break_even_words(found: BreakEven, hours: float, rates: Sequence[float]) -> str:
    """Where risky training pays, as a sentence. hours: events per vehicle-hour at the rate 1; rates: asked about."""

    def at(rate: float) -> str:
        return f"{float(f'{hours * rate:.2g}'):,g}"

    def span(ends: tuple[float, float]) -> str:
        return f"at {at(ends[0])}" if ends[0] == ends[1] else f"from {at(ends[0])} to {at(ends[1])}"

    unit = "events per vehicle-hour"
    if found.rate == found.rate:
        above, below = ("fewer", "more") if found.less[1] > found.more[1] else ("more", "fewer")
        return (
            f"treated agents crash in {above} episodes above {at(found.rate)} {unit} (between {at(found.low)} and "
            f"{at(found.high)}), and in {below} below"
        )
    sides = [(found.less, "fewer"), (found.more, "more")]
    parts = [f"in {word} episodes {span(ends)} {unit}" for ends, word in sides if ends[0] == ends[0]]
    if not parts:
        return "nothing is decided at any rate"
    is_all = (rates[0], rates[-1]) in (found.less, found.more)
    rest = (
        ", all that were asked about" if is_all else "; nothing is decided elsewhere, and no rate breaks even"
    )
    return f"treated agents crash {' and '.join(parts)}{rest}"


@styled
def break_even_figure(table: pd.DataFrame) -> str:
    """Crashes per episode of both arms against the rate of events, by task, on logarithmic axes, with ROADS as lines.

    table: as `break_even.py` writes.
    """
    figure, columns = by_task(table, 1, 2.6, sharey=True)
    for task, [axes] in columns.items():
        own = table[table["task"] == task]
        hourly = own["events_per_hour"]
        for arm in ARMS:
            value, low, high = (own[f"{arm}{end}_per_episode"] for end in ENDS)
            low = low.clip(lower=value.where(value > 0, 1e-6) / 30)
            axes.fill_between(hourly, low, high, color=COLOURS[arm], alpha=0.15, lw=0)
            axes.plot(hourly, value.where(value > 0), color=COLOURS[arm], marker="o", ms=3, label=arm)
        for name, (rate, line) in ROADS.items():
            axes.axvline(rate, color=MUTED, lw=0.8, ls=line, label=name)
        axes.set(xscale="log", yscale="log")
    figure.axes[0].set_ylabel("crashes per episode")
    figure.supxlabel("risk events per vehicle and hour", fontsize=8.5)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(handles))
    return to_svg(
        figure, "break-even", "Crashes per episode of control and treated agents against the rate of events"
    )
