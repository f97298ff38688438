"""What the report says about SUMO: the stored verdict, where it is on what the cells were computed with."""

from __future__ import annotations

import copy
from typing import Any

import pytest

from experiments.study.design.fingerprint import known_dynamics
from experiments.study.design.verdict import verdicts, versions
from tests.tasks import PUBLISHED


def cells(*tasks: str) -> list[dict[str, Any]]:
    """Records of cells of today."""
    keys = [{"task": task, "backend": "sumo", "dynamics": known_dynamics("sumo", task)} for task in tasks]
    return [{"key": key, "versions": {**versions(), "torch": "2"}} for key in keys]


def test_the_package_knows_the_present_dynamics() -> None:
    found = verdicts(cells(*PUBLISHED))
    assert found.keys() == set(PUBLISHED) and all(sum(own["counts"].values()) for own in found.values())
    assert verdicts(cells("u-turn", "u-turn")).keys() == {"u-turn"}


@pytest.mark.parametrize(
    ("part", "changed"),
    [("key", {"dynamics": "other"}), ("key", {"task": "none"}), ("versions", {"libsumo": "0.0"})],
    ids=str,
)
def test_a_verdict_on_others_is_not(part: str, changed: dict[str, str]) -> None:
    known = cells("highway", "u-turn")
    others = copy.deepcopy(known)
    others[1][part] |= changed
    assert verdicts(known) and not verdicts(others)
