"""Commands whose tests are not about processes."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells and episodes are computed in a thread, which starts at once."""
    for module in ("cells", "batches"):
        opened = f"experiments.study.compute.{module}.open_executor"
        monkeypatch.setattr(opened, lambda *_: (ThreadPoolExecutor(1), 1))
    opened = "experiments.study.compute.frozen_test.LocalExecutor"
    monkeypatch.setattr(opened, lambda _: ThreadPoolExecutor(1))


@pytest.fixture(scope="class")
def words_alone() -> Iterator[None]:
    """Reports without figures: drawing them takes longer than all else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.reporting.page.drawn", lambda *_: defaultdict(lambda: None))
        yield
