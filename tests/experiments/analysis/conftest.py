"""For all tests of the analysis."""

from __future__ import annotations

import gc

import pytest


@pytest.fixture(autouse=True, scope="module")
def what_was_made_before_stays() -> None:
    """statsmodels collects garbage at each adjustment of p-values: .1 s and more where many modules are loaded."""
    gc.collect()
    gc.freeze()
