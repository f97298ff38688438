"""A study that is made up."""

from __future__ import annotations

import pytest

from experiments.analysis.analysis import Analysis, analyse
from experiments.study.results.store import Results, load
from tests.experiments import synthetic


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    directory = tmp_path_factory.mktemp("results")
    synthetic.write(directory, {"highway": (1, 2), "u-turn": (1, 2, 3)}, seeds=4, effect=-0.2)
    return load(directory)


@pytest.fixture(scope="module")
def analysis(results: Results) -> Analysis:
    return analyse(results)
