"""Commands whose tests are not about processes, and a finished sweep of the fake environment."""

import shutil
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tests.experiments.computed import sweep_of


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells and episodes are computed in a thread, which starts at once, on simulators that are not checked."""
    for module in ("cells", "batches"):
        opened = f"experiments.study.compute.{module}.open_executor"
        monkeypatch.setattr(opened, lambda *_: (ThreadPoolExecutor(1), 1))
    opened = "experiments.study.compute.frozen_test.LocalExecutor"
    monkeypatch.setattr(opened, lambda _: ThreadPoolExecutor(1))
    for command in ("attainable", "doses", "evaluate", "rare", "takeover", "train", "validate"):
        monkeypatch.setattr(f"experiments.{command}.check_dynamics", lambda _: None)


@pytest.fixture(scope="class")
def words_alone() -> Iterator[None]:
    """Reports without figures: drawing them takes longer than all else."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.reporting.page.drawn", lambda *_: defaultdict(lambda: None))
        yield


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep, which no test changes."""
    directory = tmp_path_factory.mktemp("finished") / "results"
    sweep_of(directory)
    return directory


@pytest.fixture
def results(finished: Path, tmp_path: Path) -> Path:
    """A copy of it, which a test may change."""
    return shutil.copytree(finished, tmp_path / "results")
