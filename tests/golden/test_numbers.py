"""The numbers of the published folders stay what they were (README.md says how to change them)."""

from __future__ import annotations

import pytest

from experiments.analysis.analysis import analyse, stored
from experiments.study.results.store import load
from tests.golden import numbers
from tests.golden.numbers import PUBLISHED, RESULTS


@pytest.mark.parametrize("folder", PUBLISHED)
def test_the_published_numbers_are_the_golden_ones(folder: str) -> None:
    """Those of the folder's own analysis.json, by the same plan, and for folders that are complete the golden ones."""
    analysis, published = analyse(load(RESULTS / folder)), stored(RESULTS / folder / "analysis.json")
    assert analysis.plan_hash == published.plan_hash
    now = numbers.numbers(analysis, folder)
    then = [numbers.numbers(published, folder)]
    if folder in numbers.FOLDERS:
        then.append(numbers.golden(folder))
    for known in then:
        found = numbers.differences(known, now)
        assert found.empty, found.to_string(max_rows=12)
