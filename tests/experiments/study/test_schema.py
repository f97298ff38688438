"""What is stored is checked where it is read: right checksums do not make wrong contents right.

All of `tests.faults.corruptions` takes minutes; here are some of each kind.
"""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from agents.schema import Wrong, check, parsed
from experiments.study.results.store import load
from experiments.support.errors import UserError
from tests.faults.corruptions import results_of, rewrite, small, wrong_contents

SAID = {
    "key.level=99": r"key\.level must be one of 1, not 99",
    "key.backend='carla'": r"key\.backend must be one of sumo, highway-env, replica, not 'carla'",
    "key.arm='placebo'": r"key\.arm must be one of .*, not 'placebo'",
    "key.seed='0'": r"key\.seed must be a whole number from 0 to .*, not '0'",
    "no key.eval": r"key\.eval is missing",
    "key.env_config.policy_frequency=0": r"policy_frequency must be a whole number from 1 to 999, not 0",
    "key=[]": r"key must be dict, not \[\]",
    "learner.probe_q=[]": r"learner\.probe_q is empty",
    "episodes.parquet return=nan": r"row 0: column 'return' has .*nan",
    "episodes.parquet no crashed": "it has no column 'crashed'",
    "episodes.parquet a cell without rows": "it has no rows",
    "episodes.parquet half of the scenarios": r"it has \d+ rows, and its record asks for \d+: look at scenario 1 in",
    "gates.parquet twice": r"it has \d+ rows, and its record asks for \d+",
    "rows: crash after the end": r"crash_time 10000\d\d.* is after the end of the episode",
    "gates.parquet near_misses=10000": "row 0: has 10000 near misses, more than steps",
}


@pytest.fixture(scope="module")
def packed_cells(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("packed") / "results"
    small(folder)
    return folder


@pytest.mark.parametrize("way", SAID)
def test_wrong_contents_are_named(way: str, packed_cells: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(packed_cells, tmp_path / "results")
    rewrite(folder, wrong_contents()[way])
    with pytest.raises(UserError, match=rf"parquet is damaged \(.*{SAID[way]}"):
        load(folder)


@pytest.mark.parametrize(
    "way", ["control alone", "one agent alone", "one agent less", "no careful", "no slower"]
)
def test_what_a_comparison_lacks_stands_in_the_report(way: str, packed_cells: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(packed_cells, tmp_path / "results")
    rewrite(folder, wrong_contents()[way])
    with pytest.raises(UserError, match="it stands in the report"):
        results_of(folder, report=True)


def test_strict_json() -> None:
    for text in ('{"a": NaN}', '{"a": -Infinity}', '{"a": 1e999}', "[" * 100_000, "{", ""):
        with pytest.raises(ValueError, match=r".+"):
            parsed(text)
    assert parsed('{"a": [1, null]}') == {"a": [1, None]}


@pytest.mark.parametrize(
    ("value", "expected", "said"),
    [
        (True, int, "it must be int, not True"),
        ({"a": 1}, {"b": int}, "it.b is missing"),
        ({"a": [1, "2"]}, {"a": [int]}, r"it.a[1] must be int, not '2'"),
        (5, range(3), "it must be a whole number from 0 to 2, not 5"),
        (["x"], ("x", None), "it must be one of x, None, not ['x']"),
        (3, {"a": int}, "it must be dict, not 3"),
        ([1, 2], [int] * 3, "it must have 3 items, not 2"),
    ],
)
def test_expectations(value: object, expected: object, said: str) -> None:
    with pytest.raises(Wrong, match=re.escape(said)):
        check(value, expected, "it")
    check({"a": [1, 2.0], "c": None}, {"a": [int | float], "b?": str, "c": (None, "x")})
