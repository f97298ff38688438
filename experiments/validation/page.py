"""validation.html: one file, nothing loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from experiments.validation import figures
from experiments.validation.stage import Motion

if TYPE_CHECKING:
    import pandas as pd

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"


def number(value: float | None) -> str:
    """Three significant digits, nothing for None."""
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}" if abs(value) >= 0.01 else f"{value:.3f}"


def signed(value: float | None) -> str:
    """`number` with its sign, a true minus."""
    if value is None:
        return ""
    return ("+" if value >= 0 else "\N{MINUS SIGN}") + number(abs(value))


def verdict(passed: bool | None) -> str:
    """Class of a verdict."""
    return {True: "met", False: "missed"}.get(passed, "open")  # type: ignore[arg-type]


def words(passed: bool | None) -> str:
    """A verdict in words."""
    return {True: "passed", False: "not passed"}.get(passed, "not validated")  # type: ignore[arg-type]


def draw(
    record: Mapping[str, Any],
    table: pd.DataFrame,
    motions: Mapping[str, Mapping[str, Motion]],
    artefact: Mapping[str, Motion],
) -> dict[str, str]:
    """All figures by name.

    Args:
        table: the episodes.
        motions: engine -> name of the scene -> motion.
        artefact: engine -> motion of the scene of the projection artefact.
    """
    drawn = {
        "overview": figures.overview(record["tasks"]),
        "egos": figures.egos(table),
        "fundamental": figures.fundamental(table),
        **{
            f"distributions-{task}": figures.distributions(table[table["task"] == task], task)
            for task in record["tasks"]
        },
    }
    name = "following | highway | stop and go"
    if name in motions["sumo"]:
        drawn["time_space"] = figures.time_space({engine: own[name] for engine, own in motions.items()})
    drawn["responses"] = figures.responses(motions)
    if artefact:
        drawn["artefact"] = figures.artefact(artefact)
    return drawn


def render(record: Mapping[str, Any], drawn: Mapping[str, str]) -> str:
    """The page."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=select_autoescape(("html", "j2")),
        undefined=StrictUndefined,
    )
    environment.filters.update(number=number, signed=signed)
    environment.globals.update(verdict=verdict, words=words)
    return environment.get_template("validation.html.j2").render(record=record, figures=drawn)
