"""Random fleets on random networks, one after another in one process: see `tests.sumo_env.fleets`."""

from __future__ import annotations

import json
from collections import Counter

import pytest

from tests.processes import ended
from tests.sumo_env.plans import needs_sumo

pytest.importorskip("pettingzoo")
AT_ONCE = 10


@needs_sumo
@pytest.mark.parametrize(
    "first", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in range(10, 300, AT_ONCE))]
)
def test_fleets_end_by_themselves_or_by_an_error_of_the_simulator(first: int) -> None:
    """Nobody arrives who has not driven, is paid more than there is to earn, or touches a car that saw it otherwise."""
    done = ended("-m", "tests.sumo_env.fleets", first, AT_ONCE)
    assert done.returncode == 0, done.stderr[-2000:]
    fleets = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    assert [fleet["seed"] for fleet in fleets] == list(range(first, first + AT_ONCE))
    assert {fleet["seed"]: fleet["wrong"] for fleet in fleets if fleet["wrong"]} == {}
    endings = sum((Counter(fleet["endings"]) for fleet in fleets), Counter[str]())
    assert {"crash", "arrived", "removed", "pairs"} <= set(endings)
