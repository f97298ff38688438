"""Which cells are compared: of one setting, complete, and none twice."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from experiments.analysis.analysis import analyse
from experiments.analysis.cells import comparable, duplicates
from experiments.study.grid import BASELINES
from experiments.study.store import Results, load
from tests.experiments import synthetic


class TestSettingsAreNotMixed:
    def test_the_last_sweep_decides(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, updates=200, baselines=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, updates=400)
        chosen = comparable(load(tmp_path))
        assert len(chosen.left_out) == 6
        assert all("updates 200 instead of 400" in reason for reason in chosen.left_out.values())
        assert set(chosen.results.agents["updates"].dropna()) == {400}
        assert set(chosen.results.episodes["cell"]) == set(chosen.results.cells)

    def test_baselines_of_another_test_are_left_out(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=10, arms=())
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=20, baselines=())
        left_out = comparable(load(tmp_path)).left_out
        assert len(left_out) == len(BASELINES)
        assert all("episodes 10 instead of 20" in reason for reason in left_out.values())

    def test_presets_are_labels(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, preset="quick")
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=3, preset="paper")
        found = analyse(load(tmp_path))
        assert found.notes["left_out"] == {} and found.effects["seeds_arm"].iloc[0] == 3
        assert found.provenance["presets"] == ["paper", "quick"]

    def test_cells_that_fit_no_comparison_are_left_out_and_named(self, tmp_path: Any) -> None:
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, further=("dense",), updates=200)
        synthetic.write(tmp_path, {"u-turn": (1,)}, seeds=2, tests=8, updates=400)
        found = comparable(load(tmp_path))
        assert "dense" not in set(found.results.episodes["arm"])
        assert len(found.left_out) == 6


class TestIncompleteData:
    @pytest.mark.parametrize(
        ("damage", "words"),
        [
            (
                lambda rows: rows.assign(**{"return": rows["return"].where(rows["scenario"] > 3)}),
                "not a number",
            ),
            (lambda rows: rows.assign(**{"return": np.inf}), "not a number"),
            (lambda rows: rows[rows["scenario"] < 7], "7 of 20 test scenarios in regular traffic"),
            (lambda rows: rows[rows["traffic"] == "regular"], "0 of 20 test scenarios in risky traffic"),
            (lambda rows: pd.concat([rows, rows.iloc[:1]]), "some twice"),
        ],
    )
    def test_is_named_and_not_counted(self, results: Results, damage: Any, words: str) -> None:
        name = next(name for name in results.cells if "u-turn-3-treatment" in name)
        own = results.episodes["cell"] == name
        episodes = pd.concat([results.episodes[~own], damage(results.episodes[own])], ignore_index=True)
        found = comparable(replace(results, episodes=episodes))
        assert list(found.incomplete) == [name] and words in found.incomplete[name]
        assert set(found.results.cells) == set(results.cells) - {name} == set(found.results.episodes["cell"])

    def test_the_same_agent_twice_is_noticed(self, results: Results) -> None:
        others = [name for name in results.cells if "u-turn-3-treatment" in name][:2]
        cells = {key: {**cell} for key, cell in results.cells.items()}
        for other in others:
            cells[other]["learner"] = {**cells[other]["learner"], "weights_sha256": "0"}
        assert duplicates(replace(results, cells=cells)) == [sorted(others)]
