"""A finished sweep of the fake environment, for tests of what is stored; none of them changes it."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.experiments.computed import sweep_of


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("finished") / "results"
    sweep_of(directory)
    return directory
