"""The numbers of the published folders stay what they were (README.md says how to change them)."""

from __future__ import annotations

import pytest

from experiments.analysis.analysis import analyse
from experiments.study.store import load
from tests.golden import numbers
from tests.golden.test_golden import report


@pytest.mark.parametrize("folder", numbers.FOLDERS)
def test_the_published_numbers_are_the_golden_ones(folder: str) -> None:
    found = numbers.differences(numbers.numbers(analyse(load(numbers.ROOT / "results" / folder)), folder))
    assert not found, report(found)
