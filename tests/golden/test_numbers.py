"""The numbers of the published folders stay what they were (README.md says how to change them)."""

from __future__ import annotations

import pytest

from experiments.analysis.analysis import analyse
from experiments.study.store import load
from tests.golden import numbers


@pytest.mark.parametrize("folder", numbers.FOLDERS)
def test_the_published_numbers_are_the_golden_ones(folder: str) -> None:
    found = numbers.differences(numbers.numbers(analyse(load(numbers.ROOT / "results" / folder)), folder))
    assert found.empty, found.to_string(max_rows=12)
