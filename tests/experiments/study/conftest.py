"""A finished sweep of the fake environment, for tests of what is stored."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.experiments.computed import sweep_of


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Which no test changes."""
    directory = tmp_path_factory.mktemp("finished") / "results"
    sweep_of(directory)
    return directory


@pytest.fixture
def results(finished: Path, tmp_path: Path) -> Path:
    """A copy, which a test may change."""
    return shutil.copytree(finished, tmp_path / "results")
