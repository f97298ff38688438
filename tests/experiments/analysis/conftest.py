"""A study that is made up, and plans that others of them follow."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from experiments.analysis import plan
from experiments.analysis.analysis import Analysis, analyse
from experiments.study.results.loaded import Results, load
from tests.experiments import synthetic

SMALLEST = (("highway", "50"), ("u-turn", "3"))
# A plan like the study's of a size that is quickly made up, by the label of made-up results.
SMALL = replace(plan.STUDY, stages={"a": SMALLEST, "b": (*SMALLEST, ("u-turn", "6"))}, seeds=2)
# What `synthetic.write` is asked for where a module says nothing else.
USUAL: dict[str, Any] = {"levels": {"highway": (1, 2), "u-turn": (1, 2, 3)}, "seeds": 4, "effect": -0.2}
USUAL["baselines"] = ("careful",)


@pytest.fixture(scope="module", autouse=True)
def plans() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan, "PLANS", {"study": plan.STUDY, "small": SMALL})
        yield


@pytest.fixture(scope="module")
def results(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Results:
    """Of a module that has a MADE_UP, a study as that says."""
    directory = tmp_path_factory.mktemp("results")
    synthetic.write(directory, **getattr(request.module, "MADE_UP", USUAL))
    return load(directory)


@pytest.fixture(scope="module")
def analysis(results: Results) -> Analysis:
    return analyse(results)
