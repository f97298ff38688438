"""validation.html: one file, nothing loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from experiments.study.grid import level_names
from experiments.study.verdict import every_check
from experiments.validation import figures
from experiments.validation.egos import CORE

if TYPE_CHECKING:
    import pandas as pd

TEMPLATES = Path(__file__).resolve().parents[1] / "templates"
WORDS = {True: "within all margins", False: "margins missed", None: "no verdict"}


def number(value: float | None) -> str:
    """Three significant digits, nothing for None."""
    if value is None:
        return ""
    size = abs(value)
    return f"{value:.0f}" if size >= 1000 else f"{value:.3g}" if size >= 0.01 or not value else f"{value:.3f}"


def signed(value: float | None) -> str:
    """`number` with its sign, a true minus."""
    return "" if value is None else ("+" if value >= 0 else "\N{MINUS SIGN}") + number(abs(value))


def draw(record: Mapping[str, Any], table: pd.DataFrame) -> dict[str, str]:
    """All figures by name, from the record of validation.json and the table of episodes."""
    tasks, core = record["tasks"], table[table["ego"].isin(CORE)]
    drawn = {f"overview-{t}": figures.overview(tasks, t) for t in dict.fromkeys(table["traffic"])}
    for task in tasks:
        names = level_names(task)
        drawn[f"distributions-{task}"] = figures.distributions(core, record["backend"], task, names)
    return drawn


def missed(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every check that missed its margin, with its task, traffic and level."""
    return [
        {**item, "task": task, "traffic": traffic, "level": level}
        for task, result in record["tasks"].items()
        for traffic, level, item in every_check(result)
        if item["verdict"] == "missed"
    ]


def render(record: Mapping[str, Any], drawn: Mapping[str, str]) -> str:
    """The page."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=select_autoescape(("html", "j2")),
        undefined=StrictUndefined,
    )
    environment.filters.update(number=number, signed=signed)
    template = environment.get_template("validation.html.j2")
    return template.render(record=record, figures=drawn, words=WORDS, missed=missed(record))
