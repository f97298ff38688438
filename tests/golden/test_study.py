"""What the study computes from given results stays what it was (README.md says how to change it)."""

from __future__ import annotations

import pytest

from experiments.analysis.analysis import analyse
from experiments.study.results import load
from tests.golden import numbers, study
from tests.golden.regenerate import read, significant
from tests.golden.scenes import differences
from tests.golden.test_golden import report


def test_the_analysis_of_made_up_cells_is_the_golden_one() -> None:
    found = differences(significant(study.analysis()), read("analysis.json"))
    assert not found, report(found)


@pytest.mark.parametrize("folder", numbers.FOLDERS)
def test_the_published_numbers_are_the_golden_ones(folder: str) -> None:
    rows = numbers.numbers(analyse(load(numbers.ROOT / "results" / folder)))
    found = numbers.differences(numbers.table(rows, folder))
    assert not found, report(found)
