"""For all tests of the analysis."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="module")
def what_is_loaded_stays() -> Iterator[None]:
    """statsmodels collects garbage at each adjustment of p-values: .1 s and more where many modules are loaded."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()
