"""The pages that quote tables: filled from their templates, and their numbers counted a second time."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from docs import pages
from docs.pages import ROOT, filled, page_of, templates
from tests.pages import PAGES, TEXTS, section, table

each_template = pytest.mark.parametrize("template", templates(), ids=lambda path: path.name)


@each_template
def test_a_page_is_what_its_template_makes_of_the_results(template: Path) -> None:
    page = page_of(template)
    assert TEXTS[page] == filled(template), f"make pages writes {page.relative_to(ROOT)} again"


def test_each_page_that_says_so_has_a_template() -> None:
    made = [page for page in PAGES if TEXTS[page].startswith("<!-- Filled by")]
    assert sorted(made) == sorted(map(page_of, templates())) != []


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_all_lines_of_a_table_have_as_many_cells(page: Path) -> None:
    for rows in re.findall(r"(?:^\|.*\n)+", TEXTS[page], re.MULTILINE):
        assert len({line.count("|") for line in rows.splitlines()}) == 1, rows


def test_doses_in_units_of_the_road_are_those_of_the_table() -> None:
    stored = pq.read_table(ROOT / "results" / "road-units.parquet").to_pylist()
    highway = [line for line in stored if line["task"] == "highway"]
    assert [line["traffic"] for line in highway] == ["0", "0.25", "0.5", "0.75", "1", "measured"]
    shown = map(float, pages.road_units("highway", "lane_changes", 2).split(" | "))
    assert list(shown) == pytest.approx([highway[k]["lane_changes"] for k in (0, 4, 5)], abs=0.0051)


def test_the_checks_of_the_validation_are_counted() -> None:
    verdict = json.loads((ROOT / "experiments" / "validation" / "verdict.json").read_text())
    numbers = [own["counts"] for own in verdict.values()]
    found = pages.validation()
    assert found["all"] == sum(sum(own.values()) for own in numbers)
    assert (
        found["missed"]
        == sum(len(own["missed"]) for own in verdict.values())
        == found["all"] - found["passed"]
    )


def test_the_table_of_all_folders_names_each_published_one() -> None:
    rows = table(section(TEXTS[ROOT / "docs" / "earlier-studies.md"], "All folders"))
    published = (path.parent.name for path in (ROOT / "results").glob("*/PUBLISHED.md"))
    assert sorted(rows) == sorted(f"results/{name}" for name in published)
