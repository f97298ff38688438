"""How figures look: the palette, and a figure as an inlined SVG.

Everything that draws uses this module, and it uses nothing of the study. Figures are deterministic (the
same data give the same bytes); their colours are CSS variables with a fallback, so that a page can show them in a light
or a dark scheme, and their ids carry the figure's name.
"""

from __future__ import annotations

import functools
import html
import io
import re
from collections.abc import Callable
from typing import Any, ParamSpec

import numpy as np
from matplotlib import rc_context, rcdefaults, rcParams
from matplotlib.figure import Figure

WIDTH = 7.2  # [inch]
INK, MUTED, GRID, PAPER = "#1f2328", "#6b7280", "#d9dde3", "#ffffff"
CONTROL, TREATMENT, CAREFUL = "#0072b2", "#d55e00", "#009e73"  # Okabe and Ito: told apart by all eyes
COLOURS = {"control": CONTROL, "mixed": "#cc79a7", "treatment": TREATMENT}  # by arm, in the order of the risk
VARIABLES = {
    INK: "ink", MUTED: "muted", GRID: "grid", PAPER: "paper",
    CONTROL: "control", TREATMENT: "treatment", CAREFUL: "careful",
}  # fmt: skip
STYLE: Any = {
    "font.family": "sans-serif", "font.sans-serif": ["DejaVu Sans"], "font.size": 8.5,
    "axes.titlesize": 9, "axes.titleweight": "bold", "axes.labelsize": 8.5,
    "xtick.labelsize": 8, "ytick.labelsize": 8, "legend.fontsize": 8, "legend.frameon": False,
    "text.color": INK, "axes.labelcolor": INK, "axes.titlecolor": INK,
    "xtick.color": MUTED, "ytick.color": MUTED, "xtick.labelcolor": INK, "ytick.labelcolor": INK,
    "axes.edgecolor": MUTED, "axes.linewidth": 0.7, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "axes.axisbelow": True, "grid.color": GRID, "grid.linewidth": 0.6,
    "xtick.major.size": 2.5, "ytick.major.size": 2.5, "lines.linewidth": 1.6, "lines.markersize": 5,
    "figure.facecolor": "none", "axes.facecolor": "none", "savefig.facecolor": "none",
    "svg.fonttype": "none", "svg.hashsalt": "report",
}  # fmt: skip


Arguments = ParamSpec("Arguments")


def styled(draw: Callable[Arguments, str]) -> Callable[Arguments, str]:
    """Let a function draw in the report's style, whatever the user's own settings are."""

    @functools.wraps(draw)
    def in_style(*args: Arguments.args, **kwargs: Arguments.kwargs) -> str:
        with rc_context():
            rcdefaults()
            rcParams.update(STYLE)
            return draw(*args, **kwargs)

    return in_style


def new_figure(rows: int, columns: int, height: float, **options: Any) -> tuple[Figure, np.ndarray]:
    """A figure of the report's width with an array (rows, columns) of axes; height in inches."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def to_svg(figure: Figure, name: str, description: str) -> str:
    """The figure as an <svg> element to be inlined; `description` is read to people who do not see it."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata=dict.fromkeys(("Date", "Creator", "Format", "Type")))
    text = buffer.getvalue()
    text = text[text.index("<svg") :].strip()
    text = re.sub(r'\bid="', f'id="{name}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", text)
    for colour, variable in VARIABLES.items():
        text = re.sub(colour, f"var(--{variable}, {colour})", text, flags=re.IGNORECASE)
    label = html.escape(description, quote=True)
    return text.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)
