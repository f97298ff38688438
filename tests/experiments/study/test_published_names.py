"""Names of published cells: each is the hash of its key, none was renamed, and the dynamics in the keys are today's."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from experiments.study.fingerprint import fingerprint
from experiments.study.grid import cell_name
from experiments.study.results import load

RESULTS = Path(__file__).resolve().parents[3] / "results"
# Number of published cells of each folder, and the SHA-256 of their sorted names, one per line.
PUBLISHED = {
    "standard": (653, "e21908dc03fbd90d299010c9136eb304c4417966afd6a7cb5231ffd50152de34"),
    "replica": (180, "efd00ce3ffc276df4f3ad3b2dfc712e0b9d532a527a876017fe1e8f82f7c1dde"),
    "paper": (80, "cb62cc3b4b74c29f98ae26d61967d9da89e13cb155e5c6cdf5842aea8a049e14"),
    "paper-v0": (80, "d18afae7e65c6dac084f0b65661d6f6812e20514a2ae1bf1720a12aacd2c3e0e"),
    "linear": (32, "8cf581dd64a7138c7204efd89423e226c71c1da521ceb92cb246dc7c117d4206"),
}
DYNAMICS = {
    "sumo": {
        "highway": "78a7957b",
        "two-way": "6f3a1a70",
        "roundabout": "11ab2253",
        "intersection": "2bd7f9b7",
        "u-turn": "316a1bd5",
    },
    "replica": {
        "highway": "07f6c462",
        "two-way": "fdf6bfca",
        "roundabout": "3af3ec0d",
        "intersection": "65f56153",
        "u-turn": "c52133d9",
    },
    "highway-env": {
        "highway": "20166deb",
        "two-way": "a693fc2b",
        "roundabout": "956b1f94",
        "intersection": "2f497bfa",
        "u-turn": "62ddf504",
    },
}


@cache
def cells(folder: str) -> dict[str, dict[str, Any]]:
    return load(RESULTS / folder).cells


@pytest.mark.parametrize("folder", PUBLISHED)
def test_a_published_cell_is_named_by_its_key(folder: str) -> None:
    found = cells(folder)
    assert [name for name, cell in found.items() if cell_name(cell["key"], cell["versions"]) != name] == []
    digest = hashlib.sha256("".join(f"{name}\n" for name in sorted(found)).encode()).hexdigest()
    assert (len(found), digest) == PUBLISHED[folder]


@pytest.mark.parametrize("folder", PUBLISHED)
def test_the_dynamics_of_published_cells_are_known(folder: str) -> None:
    stored = set()
    for cell in cells(folder).values():
        for key in (cell["key"], {**cell["key"], **cell["key"].get("test_on", {})}):
            stored.add((key["backend"], key["task"], key["dynamics"]))
    assert stored <= {(backend, task, digits) for backend in DYNAMICS for task, digits in DYNAMICS[backend].items()}


@pytest.mark.parametrize("backend", ["sumo", "replica"])
@pytest.mark.parametrize("task", DYNAMICS["sumo"])
def test_the_simulators_do_what_they_did(backend: str, task: str) -> None:
    assert fingerprint(backend, task) == DYNAMICS[backend][task]
