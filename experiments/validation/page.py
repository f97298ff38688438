"""validation.html: one file, nothing loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from experiments.reporting.style import CONTROL, GRID, INK, TREATMENT, new_figure, styled, to_svg
from experiments.study.verdict import every_check
from experiments.validation.checks import MARGINS

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
WORDS = {True: "within all margins", False: "margins missed", None: "no verdict"}
OWN, THEIRS = TREATMENT, CONTROL
FARTHEST = 2.2  # margins; what lies beyond is drawn at the edge
ROWS = [metric for metric in MARGINS if metric != "order"]


def number(value: float | None, sign: str = "") -> str:
    """Three significant digits and a true minus, nothing for None; sign: "+" for differences."""
    if value is None:
        return ""
    size = abs(value)
    form = ".0f" if size >= 1000 else ".3g" if size >= 0.01 or not value else ".3f"
    return f"{value:{sign}{form}}".replace("-", "\N{MINUS SIGN}")


def missed(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every check that missed its margin, with its task, level and traffic as `where`."""
    return [
        {**item, "where": f"{task} {level}, {traffic}"}
        for task, result in record["tasks"].items()
        for traffic, level, item in every_check(result)
        if item["verdict"] == "missed"
    ]


def render(record: Mapping[str, Any]) -> str:
    """The page, from the content of validation.json."""
    tasks = record["tasks"]
    traffics = dict.fromkeys(traffic for found in tasks.values() for traffic in found["traffics"])
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=select_autoescape(("html", "j2")),
        undefined=StrictUndefined,
    )
    environment.filters.update(number=number, signed=partial(number, sign="+"))
    return environment.get_template("validation.html.j2").render(
        record=record,
        overviews={traffic: overview(tasks, traffic) for traffic in traffics},
        words=WORDS,
        missed=missed(record),
    )


@styled
def overview(tasks: Mapping[str, Any], traffic: str) -> str:
    """Every check with a margin: its difference as a share of the margin, with its interval."""
    figure, axes = new_figure(1, len(tasks), 4.6, sharey=True, sharex=True)
    for panel, (task, result) in zip(axes[0], tasks.items(), strict=True):
        panel.axvspan(-1, 1, color=GRID, alpha=0.6, lw=0)
        panel.axvline(0, color=INK, lw=0.8)
        panel.set_title(task)
        judged = [c for t, _, c in every_check(result) if t == traffic and c["margin"] and c["verdict"]]
        for row, metric in enumerate(ROWS):
            shown = [item for item in judged if item["metric"] == metric]
            for item, place in zip(shown, np.linspace(0.35, -0.35, len(shown)), strict=True):
                _share(panel, item, place - row)
        panel.grid(axis="y", visible=False)
        panel.set_xlim(-FARTHEST, FARTHEST)
    axes[0, 0].set_yticks([-row for row in range(len(ROWS))], [metric.replace("_", " ") for metric in ROWS])
    figure.supxlabel("difference as a share of its margin (filled: equivalent)", fontsize=8.5)
    return to_svg(figure, f"overview-{traffic}", f"All checks in {traffic} traffic: difference over margin")


def _share(panel: Any, item: Mapping[str, Any], y: float) -> None:
    colour = OWN if item["verdict"] == "missed" else THEIRS
    if item["low"] is not None:
        ends = np.array([item["low"], item["high"]]) / item["margin"]
        panel.plot(np.clip(ends, -FARTHEST, FARTHEST), [y, y], color=colour, lw=0.9)
    fill = {} if item["verdict"] == "equivalent" else {"mfc": "white"}
    share = float(np.clip(item["difference"] / item["margin"], -FARTHEST, FARTHEST))
    panel.plot(share, y, "o", color=colour, ms=3.2, mew=0.9, **fill)
