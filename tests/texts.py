"""The documentation as tests read it: its pages, their sections and tables."""

from __future__ import annotations

import re
from itertools import dropwhile, takewhile

from tests.processes import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TEXTS = {page: page.read_text(encoding="utf-8") for page in PAGES}


def section(text: str, title: str) -> str:
    """What stands under a heading, subsections included."""
    found = re.search(rf"^(#+) {re.escape(title)}\n(.*?)(?=^\1 |\Z)", text, re.DOTALL | re.MULTILINE)
    assert found, f"no section {title!r}"
    return found[2]


def table(text: str) -> dict[str, list[str]]:
    """The rows of the first table of a text: first cell -> the other cells, backticks removed from the first."""
    rows = dropwhile(lambda line: not line.startswith("|"), text.splitlines())
    lines = list(takewhile(lambda line: line.startswith("|"), rows))[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {first.strip("`"): others for first, *others in cells}


def page(name: str) -> str:
    """The text of a page of docs/."""
    return TEXTS[ROOT / "docs" / name]
