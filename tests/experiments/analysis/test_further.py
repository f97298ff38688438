"""Arms and tests beside the plan."""

from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from experiments.analysis.analysis import Analysis, analyse
from experiments.analysis.comparable import comparable
from experiments.analysis.effects import WORKING_COLUMNS
from experiments.analysis.scores import once_each
from experiments.study.design import experiment
from experiments.study.design.traffic import AT_A_DOSE
from experiments.study.results.loaded import Results, load
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from tests.experiments import synthetic
from tests.experiments.analysis.made_up import find

LEVELS = {"highway": (1,), "u-turn": (1,)}
FURTHER = ("mixed", "told", "dose50")
STUDY: dict[str, Any] = {"seeds": 3, "tests": 20, "effect": -0.4, "spread": 0.01, "baselines": ("careful",)}
MADE_UP = {"levels": LEVELS, **STUDY, "further": FURTHER, "test_on": ("replica", "highway-env")}


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
    """All of them, on highway-env in 20 scenarios."""
    rows = analysis.by_task.query("scope == 'all tasks' and outcome == 'crashed' and traffic == 'risky'")
    rows = rows.set_index("tested_on")
    assert {*rows.index} == {"sumo", "replica", "highway-env"}
    assert (rows["high"] < 0).all() and (rows["seeds_arm"] == 6).all()
    wanted = {"scope": "all tasks", "outcome": "crashed", "term": "risky"}
    assert rows.loc["sumo", "estimate"] == pytest.approx(find(analysis.means, **wanted)["estimate"])


def is_elsewhere(key: dict[str, Any]) -> bool:
    return (key.get("test_on") or {}).get("backend") == "replica"


# Which cells another version has computed, and what tells it: tests on another simulator, an arm, a policy.
OLDER: list[tuple[Any, Any]] = [
    (is_elsewhere, lambda cell: cell["key"]["test_on"].update(dynamics="00000000")),
    (is_elsewhere, lambda cell: cell["versions"].update(numba="0.1")),
    (
        lambda key: (key["kind"], key["arm"]) == ("agent", "dose50"),
        lambda cell: cell["key"]["profile"].update(gamma=0.5),
    ),
    (lambda key: key["policy"] == "careful", lambda cell: cell["key"].update(dynamics="00000000")),
]


def test_cells_of_two_versions_never_share_a_mean(results: Results, analysis: Analysis) -> None:
    """Those of earlier versions, in which everybody crashed, are named and count nowhere."""
    parts: list[Any] = [(results.cells, results.episodes, results.gate_episodes)]
    for number, (which, change) in enumerate(OLDER):
        names = {name: f"{number} {name}" for name, cell in results.cells.items() if which(cell["key"])}
        cells = {names[name]: deepcopy(results.cells[name]) for name in names}
        for cell in cells.values():
            change(cell)
        tables = (
            table[table["cell"].isin(names)].assign(cell=table["cell"].map(names))
            for table in (results.episodes.assign(crashed=True), results.gate_episodes)
        )
        parts.insert(0, (cells, *tables))
    every, episodes, gates = zip(*parts, strict=True)
    both = replace(
        results,
        cells={name: cell for part in every for name, cell in part.items()},
        episodes=pd.concat(episodes, ignore_index=True),
        gate_episodes=pd.concat(gates, ignore_index=True),
    )
    found = analyse(both)
    assert set(found.notes["left_out"]) == set(both.cells) - set(results.cells)
    for name in ("effects", "means", "policies", "gates"):
        pd.testing.assert_frame_equal(getattr(found, name), getattr(analysis, name))


def test_a_test_of_other_weights_than_its_agent_s_counts_nowhere(results: Results) -> None:
    mixed = results.table[results.table["arm"] == "mixed"]
    agent, test = (mixed.index[mixed["kind"] == kind][0] for kind in ("agent", "test"))
    for digest, left_out in (("another", {test: "its agent was trained again"}), (None, {})):
        record = results.cells[test] | {"tested": {"cell": agent, "sha256": digest}}
        assert comparable(replace(results, cells=results.cells | {test: record}))[1] == left_out


def test_a_traffic_that_two_cells_test_counts_once(tmp_path: Path) -> None:
    """An agent's own test counts, then the test that was asked for last; the others are named."""
    synthetic.write(tmp_path, LEVELS, **STUDY, traffics=("dose25", "dose75"))
    cells = synthetic.write(tmp_path, LEVELS, **STUDY, traffics=("dose25", "dose50"))
    every = [cell for cell in cells if cell.kind == "agent"]
    again = [replace(one, kind="test", test_on=experiment.tests_of(one, ("risky",))) for one in every]
    for cell in again:
        Store(tmp_path).write(cell, {}, {EPISODES: synthetic.episodes(cell, 0.0, 0.0)})
    Store(tmp_path).write_sweep("asked for last", again)
    results = load(tmp_path)
    chosen, left_out = comparable(results)
    assert not once_each(chosen.episodes).empty
    traffics = {name: cell["key"].get("test_on", {}).get("traffics") for name, cell in results.cells.items()}
    assert {*left_out} == {name for name, own in traffics.items() if own in (["risky"], ["dose25", "dose75"])}
    assert {*results.cells} - {*chosen.cells} == {name for name, own in traffics.items() if own == ["risky"]}
    counted = chosen.episodes[chosen.episodes["traffic"] == "dose25"]
    assert all(traffics[name] == ["dose25", "dose50"] for name in counted["cell"])
    assert {*analyse(results).by_task["traffic"]} == {*AT_A_DOSE}
    with pytest.raises(UserError, match=next(iter(left_out))):
        once_each(results.episodes)
