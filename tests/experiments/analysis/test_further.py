"""Arms and tests beside the plan."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pandas as pd
import pytest

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.effects import WORKING_COLUMNS
from experiments.study.results.store import Results, load
from tests.experiments import synthetic
from tests.experiments.analysis.made_up import find

LEVELS = {"highway": (1,), "u-turn": (1,)}
FURTHER = ("dense", "penalty", "dose25", "dose50", "dose75")
STUDY: dict[str, Any] = {"seeds": 4, "tests": 40, "effect": -0.4, "spread": 0.01}


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    home = tmp_path_factory.mktemp("further")
    elsewhere = ("replica", "highway-env")
    synthetic.write(home, LEVELS, **STUDY, further=FURTHER, test_on=elsewhere)
    return load(home)


def test_nothing_that_the_plan_decides_changes(analysis: Analysis, tmp_path: Any) -> None:
    synthetic.write(tmp_path, LEVELS, **STUDY)
    alone = analyse(load(tmp_path))
    own = [
        found.effects[found.effects["family"].notna()].drop(columns=WORKING_COLUMNS)
        for found in (analysis, alone)
    ]
    pd.testing.assert_frame_equal(
        own[0].reset_index(drop=True), own[1].reset_index(drop=True), check_dtype=False
    )
    for name in ("claims", "slopes", "placebo"):
        pd.testing.assert_frame_equal(getattr(analysis, name), getattr(alone, name))
    assert analysis.notes["left_out"] == {}


def test_agents_are_compared_on_other_simulators(analysis: Analysis) -> None:
    wanted = {"scope": "all tasks", "outcome": "crashed", "term": "risky"}
    home = {}
    for simulator in ("replica", "highway-env"):
        away = find(analysis.means, **wanted, scenarios=simulator, tested_on=simulator)
        home[simulator] = find(analysis.means, **wanted, scenarios=simulator, tested_on="sumo")
        assert away["high"] < 0 and away["seeds_arm"] == home[simulator]["seeds_arm"] == 8
    over_all_scenarios = find(analysis.means, **wanted)["estimate"]
    assert home["replica"]["estimate"] == pytest.approx(over_all_scenarios)
    assert home["highway-env"]["estimate"] != pytest.approx(over_all_scenarios)  # the first 20 alone


def test_an_agent_that_is_lost_at_home_is_not_compared_elsewhere(results: Results) -> None:
    lost = next(
        n for n, c in results.cells.items() if (c["key"]["kind"], c["key"]["arm"]) == ("agent", "treatment")
    )
    cells = {name: cell for name, cell in results.cells.items() if name != lost}
    episodes = results.episodes[results.episodes["cell"] != lost]
    gates = results.gate_episodes[results.gate_episodes["cell"] != lost]
    found = analyse(replace(results, cells=cells, episodes=episodes, gate_episodes=gates)).means
    for tested_on in ("replica", "sumo"):
        wanted = {"outcome": "crashed", "term": "risky", "scenarios": "replica"}
        row = find(found, scope="all tasks", tested_on=tested_on, **wanted)
        assert (row["seeds_arm"], row["seeds_against"]) == (7, 8)
