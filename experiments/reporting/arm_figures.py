"""The report's picture of the further arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from experiments.analysis.pooling import ALL_TASKS
from experiments.analysis.wording import MINUS, place
from experiments.reporting.style import INK, PAPER, TREATMENT, new_figure, styled, to_svg
from experiments.study.arms import TRAFFICS

# Arms from top to bottom, by what tells them from the control.
NAMES = {
    "dose25": "risk at dose .25",
    "dose50": "risk at dose .5",
    "dose75": "risk at dose .75",
    "treatment": "risk at dose 1",
    "dense": "denser, no risk",
    "penalty": "twice the penalty",
}
COLUMNS = 3  # settings beside each other
MARKS: dict[str, dict[str, Any]] = {
    "risky": {"color": TREATMENT, "marker": "o", "mfc": TREATMENT},
    "regular": {"color": INK, "marker": "s", "mfc": PAPER},
}


@styled
def further_arms(effects: Sequence[Mapping[str, Any]], arms: Sequence[Mapping[str, Any]]) -> str:
    """How the crash rate of every arm differs from the control's, with intervals, a panel per setting.

    Args:
        effects: of `effects.effects`, for the treatment. arms: of `exploratory.arms`. Both of one backend.
    """
    records = [r for r in arms if r["against"] == "control" and r["scope"] != ALL_TASKS]
    known = {r["scope"] for r in records}
    records += [{**r, "arm": "treatment", "scope": place(r)} for r in effects if place(r) in known]
    scopes = list(dict.fromkeys(place(r) for r in effects if place(r) in known))
    rows = {arm: -number for number, arm in enumerate(NAMES) if any(r["arm"] == arm for r in records)}
    columns = min(len(scopes), COLUMNS)
    lines = -(-len(scopes) // columns)
    figure, axes = new_figure(lines, columns, 0.5 + lines * (0.7 + 0.3 * len(rows)), sharey=True)
    for panel in axes.flat[len(scopes) :]:
        panel.set_visible(False)
    for panel, scope in zip(axes.flat, scopes, strict=False):
        panel.axvline(0, color=INK, lw=0.8)
        panel.set_title(scope)
        for r in records:
            if (r["scope"], r["outcome"]) != (scope, "crashed") or r["term"] not in TRAFFICS:
                continue
            y = rows[r["arm"]] + (0.15 if r["term"] == "risky" else -0.15)
            if r["low"] is not None:
                panel.plot([r["low"], r["high"]], [y, y], color=MARKS[r["term"]]["color"], lw=1.4)
            if r["estimate"] is not None:
                panel.plot(r["estimate"], y, ls="", ms=4.5, **MARKS[r["term"]])
        panel.set_yticks(list(rows.values()), [NAMES[arm] for arm in rows])
        panel.xaxis.set_major_locator(MaxNLocator(5))
        panel.xaxis.set_major_formatter(lambda value, _: f"{100 * value:.0f}".replace("-", MINUS))
        panel.set_xlabel(f"arm {MINUS} control [points]")
        panel.grid(axis="y", visible=False)
    handles = [Line2D([], [], label=f"tested in {term} traffic", **mark) for term, mark in MARKS.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return to_svg(figure, f"{arms[0]['backend']}-arms", "Crash rate of every arm against the control")
