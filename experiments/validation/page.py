"""validation.html: one file, nothing loaded from elsewhere."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape

from experiments.study.grid import level_names
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
    own, tasks = record["backend"], list(record["tasks"])
    drawn = {}
    for traffic in dict.fromkeys(table["traffic"]):
        drawn[f"overview-{traffic}"] = figures.overview(record["tasks"], traffic)
        drawn[f"egos-{traffic}"] = figures.egos(table, own, tasks, traffic)
    core = table[table["ego"].isin(CORE)]
    drawn["survival"] = figures.survival(core, own, tasks)
    drawn["outcomes"] = figures.outcomes(core, own, tasks)
    if "highway" in tasks:
        drawn["fundamental"] = figures.fundamental(core, own)
    for task in tasks:
        drawn[f"distributions-{task}"] = figures.distributions(core, own, task, level_names(task))
    return drawn


def missed(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Every check that missed its margin, with its task, traffic and level."""
    return [
        {**item, "task": task, "traffic": traffic, "level": level}
        for task, result in record["tasks"].items()
        for traffic, levels in result["traffics"].items()
        for level, checks in levels.items()
        for item in checks
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
