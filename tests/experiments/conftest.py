"""Commands whose tests are not about processes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest


def in_this_process(patch: pytest.MonkeyPatch) -> None:
    """Cells and episodes are computed in a thread, which starts at once."""
    patch.setattr("experiments.study.compute.cells.open_executor", lambda *_: (ThreadPoolExecutor(1), 1))
    for module in ("validation.episodes", "study.compute.frozen_test"):
        patch.setattr(f"experiments.{module}.LocalExecutor", lambda _: ThreadPoolExecutor(1))


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    in_this_process(monkeypatch)


@pytest.fixture(scope="module")
def all_here() -> Iterator[None]:
    """As `here`, for all tests of a module and for its fixtures."""
    with pytest.MonkeyPatch.context() as patch:
        in_this_process(patch)
        yield


@pytest.fixture(scope="class")
def words_alone() -> Iterator[None]:
    """Reports without figures: drawing them takes longer than all else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.reporting.page.drawn", lambda *_: defaultdict(lambda: None))
        yield
