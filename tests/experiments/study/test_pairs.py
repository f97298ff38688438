"""Tests of two agents together as cells: their names, their order, and who decides in them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from agents.belief import Estimator
from agents.extra_column import Observed
from experiments import sweep, train
from experiments.study.design import estimators
from experiments.study.design.arms import PAIRS
from experiments.study.design.cell import Cell, cell_name
from experiments.study.design.options import Asked
from experiments.study.results.schema import EPISODES
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from tests.experiments.computed import compute, tasks_of

ASKED: dict[str, Any] = {"updates": 20, "seeds": 2, "pairs": True, "episodes": 4}


def known(backend: str, task: str) -> str:
    return f"{backend} {task}"


@pytest.fixture
def own_estimators(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with an untrained estimator of the lightest u-turn."""
    folder = tmp_path / "estimators"
    folder.mkdir()
    monkeypatch.setattr(estimators, "FOLDER", folder)
    Estimator(torch.tensor([[0.1, 0.9], [0.9, 0.1]])).save(folder / "u-turn-3.npz")
    return folder


def pairs(**asked: Any) -> dict[str, Cell]:
    """The tests of pairs by slug."""
    cells = Asked(preset="smoke", tasks=("u-turn",), **{**ASKED, **asked}).cells(known)
    return {cell.slug: cell for cell in cells if cell.pair}


class TestCells:
    def test_a_pair_is_a_control_and_a_treated_agent_of_one_number(self, own_estimators: Path) -> None:
        found = pairs(seeds=3)
        for name in PAIRS:
            for k in range(3):
                first, second = found[f"sumo-u-turn-3-{name}-s{k}"].parents
                assert first.startswith(f"sumo-u-turn-3-control-s{k}-")
                assert second.startswith(f"sumo-u-turn-3-treatment-s{k}-")
        assert len(found) == 3 * len(PAIRS)
        with pytest.raises(UserError, match="nothing"):
            pairs(arms=("treatment", "mixed"))

    def test_names_follow_the_estimator_where_one_is_asked(self, own_estimators: Path) -> None:
        before = pairs()
        Estimator(torch.tensor([[0.2, 0.9]])).save(own_estimators / "u-turn-3.npz")
        after = pairs()
        moved = {before[slug].arm for slug in before if before[slug].name != after[slug].name}
        assert moved == {*PAIRS} - {"more-careful"}

    def test_names_follow_agents_and_rule(self, own_estimators: Path) -> None:
        cell = pairs()["sumo-u-turn-3-weighed-s0"]
        other = pairs(updates=123)["sumo-u-turn-3-weighed-s0"]
        assert other.name != cell.name
        key = cell.key()
        assert key["pair"]["rule"] == {"weighed": [3.0, 0.3]}
        key["pair"] = {**key["pair"], "rule": {"weighed": [9.0, 0.1]}}
        assert cell_name(key, cell.versions) != cell.name

    @pytest.mark.parametrize("command", [sweep.sweep, train.train])
    def test_without_an_estimator_nothing_begins(
        self, command: Any, own_estimators: Path, tmp_path: Path
    ) -> None:
        (own_estimators / "u-turn-3.npz").unlink()
        options = sys.modules[command.__module__].Options
        asked = options(out=tmp_path / "new", tasks=("u-turn",), arms=("control", "treatment"), **ASKED)
        with pytest.raises(UserError, match=r"estimators\.py u-turn-3$"):
            command(asked, [])
        assert not (tmp_path / "new").exists()

    def test_a_dry_run_needs_no_estimator_and_names_those_that_are_missing(
        self, own_estimators: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        options = sweep.Options(preset="smoke", tasks=("u-turn",), out=tmp_path, dry_run=True, **ASKED)
        assert sweep.sweep(options) == 0
        assert "estimators.py" not in capsys.readouterr().out
        (own_estimators / "u-turn-3.npz").unlink()
        assert sweep.sweep(options) == 0
        assert "estimators.py u-turn-3\n" in capsys.readouterr().out


class TestSweep:
    """All pairs of a tiny sweep on the fake environment."""

    @pytest.fixture
    def store(self, own_estimators: Path, tmp_path: Path) -> Store:
        tasks = tasks_of(tmp_path / "out", **ASKED)
        compute([task for task in tasks if task.cell.kind == "agent"])
        compute([task for task in tasks if task.cell.pair])
        return Store(tmp_path / "out")

    def test_who_is_sure_drives_as_the_agent_of_the_traffic(self, store: Store, monkeypatch: Any) -> None:
        """The control agent at a belief of 0, the treated one at 1, and neither alone while nothing is known."""
        tables = {name.rpartition("-")[0]: store.tables(name)[EPISODES] for name in store.finished()}
        assert {*tables["sumo-u-turn-3-pair-s0"]["traffic"]} == {"regular", "risky"}
        [task] = [
            task for task in tasks_of(store.directory, **ASKED) if task.cell.slug == "sumo-u-turn-3-pair-s0"
        ]
        for belief, agent in ((0.0, "control-s0"), (1.0, "treatment-s0")):

            def sure(env: Any, _: Any, belief: float = belief) -> Observed:
                return Observed(env, lambda _: belief)

            monkeypatch.setattr("experiments.study.compute.policies.believing", sure)
            told = task._test(task.make_env("sumo", "u-turn", {}), lambda: None, {})[EPISODES]
            assert told["actions"].tolist() == tables[f"sumo-u-turn-3-{agent}"]["actions"].tolist()
