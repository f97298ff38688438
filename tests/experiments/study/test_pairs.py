"""Tests of two agents together as cells: their names, their order, and who decides in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from agents.belief import Estimator
from experiments.study.design import estimators
from experiments.study.design.arms import PAIRS
from experiments.study.design.grid import Cell, cell_name
from experiments.study.design.options import Asked
from experiments.study.design.presets import cells_of
from experiments.study.results.store import EPISODES, Store
from experiments.support.errors import UserError
from tests.experiments.computed import compute, tasks_of

ARMS = ("control", "treatment", "mixed")
ASKED: dict[str, Any] = {"updates": 20, "arms": ARMS, "seeds": 2, "pairs": True, "episodes": 4}


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
    cells = cells_of(Asked(preset="smoke", tasks=("u-turn",), **{**ASKED, **asked}), known)
    return {cell.slug: cell for cell in cells if cell.pair}


class TestCells:
    def test_each_pair_has_an_agent_of_either_half_of_the_seeds(self, own_estimators: Path) -> None:
        found = pairs(seeds=6)
        for name, pair in PAIRS.items():
            for k in range(3):
                first, second = found[f"sumo-u-turn-3-{name}-s{k}"].parents
                assert first.startswith(f"sumo-u-turn-3-{pair.arms[0]}-s{k}-")
                assert second.startswith(f"sumo-u-turn-3-{pair.arms[1]}-s{k + 3}-")
        ends = {slug.partition("-s0")[2] for slug in found if "-s0" in slug}
        assert ends == {"", "-doses", "-unseen"} and len(found) == 3 * (len(PAIRS) + 10)

    def test_names_follow_the_estimator_where_one_is_asked(self, own_estimators: Path) -> None:
        before = pairs()
        Estimator(torch.tensor([[0.2, 0.9]])).save(own_estimators / "u-turn-3.npz")
        after = pairs()
        moved = {
            PAIRS[before[slug].arm or ""].weight for slug in before if before[slug].name != after[slug].name
        }
        assert moved == {"belief", "shuffled"}

    def test_names_follow_agents_and_rule(self, own_estimators: Path) -> None:
        cell = pairs()["sumo-u-turn-3-belief-s0"]
        other = pairs(updates=123)["sumo-u-turn-3-belief-s0"]
        assert other.name != cell.name
        key = cell.key()
        assert key["pair"]["rule"] == list(estimators.RULE)
        key["pair"] = {**key["pair"], "rule": [9.0, 0.1]}
        assert cell_name(key, cell.versions) != cell.name

    def test_no_other_cell_knows_of_pairs(self, own_estimators: Path) -> None:
        asked = Asked(preset="smoke", tasks=("u-turn",), unseen=True)
        assert not any(
            "pair" in cell.key() or "estimator" in str(cell.key()) for cell in cells_of(asked, known)
        )

    def test_without_an_estimator_the_error_names_its_file(self, own_estimators: Path) -> None:
        (own_estimators / "u-turn-3.npz").unlink()
        with pytest.raises(UserError, match=r"u-turn-3\.npz"):
            pairs()


class TestSweep:
    """All pairs of a tiny sweep on the fake environment."""

    @pytest.fixture
    def store(self, own_estimators: Path, tmp_path: Path) -> Store:
        tasks = tasks_of(tmp_path / "out", **ASKED)
        compute([task for task in tasks if task.cell.kind == "agent"])
        compute([task for task in tasks if task.cell.pair and not task.cell.slug.endswith("-unseen")])
        return Store(tmp_path / "out")

    def test_who_is_told_drives_as_the_agent_of_the_traffic(self, store: Store) -> None:
        """The first of a pair at dose 0, the second at dose 1; and two agents of one arm as neither need."""
        tables = {name.rpartition("-")[0]: store.tables(name)[EPISODES] for name in store.finished()}
        told = tables["sumo-u-turn-3-true-dose-s0"]
        for traffic, agent in (("regular", "control-s0"), ("risky", "treatment-s1")):
            alone = tables[f"sumo-u-turn-3-{agent}"]
            actions = [rows.loc[rows["traffic"] == traffic, "actions"].tolist() for rows in (told, alone)]
            assert actions[0] == actions[1]
        assert set(told["traffic"]) == {"regular", "risky"}
        doses = tables["sumo-u-turn-3-half-s0-doses"]
        assert set(doses["traffic"]) == {"dose25", "dose50", "dose75"}

    def test_weights_in_half_precision_give_the_same_test(
        self, store: Store, own_estimators: Path, tmp_path: Path
    ) -> None:
        """So that pairs can be tested from the published weights."""
        [name] = [name for name in store.finished() if name.startswith("sumo-u-turn-3-belief-s0-")][:1]
        store.pack()
        for path in (store.directory / "weights").glob("*.npz"):
            with np.load(path) as arrays:
                halved = {part: arrays[part].astype(np.float16) for part in arrays.files}
            np.savez(path, **halved)
        other = tmp_path / "other"
        other.mkdir()
        for part in ("parts", "weights"):
            (other / part).symlink_to(store.directory / part)
        tasks = [task for task in tasks_of(other, **ASKED) if task.name == name]
        assert tasks[0].done()
        again = tasks[0]._test(tasks[0].make_env("sumo", "u-turn", {}), lambda: None, {})[EPISODES]
        assert again["actions"].tolist() == store.tables(name)[EPISODES]["actions"].tolist()
