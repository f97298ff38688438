"""Simulators and learners do what `fingerprints.json` says, and a change is named before a sweep begins."""

import copy
from typing import Any

import gymnasium as gym
import pytest

from experiments.backends import make_env
from experiments.study.design import fingerprint
from experiments.study.design.cell import installed
from experiments.study.design.fingerprint import check_dynamics, check_learners, driven, known_dynamics
from experiments.study.design.verdict import verdicts
from experiments.support.errors import UserError
from sumo_env.tasks import TASKS
from tests.tasks import PUBLISHED, every_task


@pytest.mark.parametrize("backend", ["sumo", "replica"])
@every_task
def test_the_simulators_do_what_they_did(backend: str, task: str) -> None:
    check_dynamics([(backend, task)])


@pytest.mark.parametrize("risk", [0.0, 1.0])
def test_a_change_in_the_middle_of_an_episode_is_noticed_at_either_dose(risk: float, monkeypatch) -> None:
    """And one that other processors might make is not."""
    known = fingerprint._table()["sumo"]["u-turn"]["behaviour"]

    class Changed(gym.Wrapper):
        size = 0.1

        def step(self, action: int) -> Any:
            observation, reward, *rest = self.env.step(action)
            inner: Any = self.unwrapped
            is_later = inner.scene.time > 4 and inner.config["risk"] == risk
            return observation, float(reward) + self.size * is_later, *rest

    name = "experiments.study.design.fingerprint.make_env"
    monkeypatch.setattr(name, lambda *asked: Changed(make_env(*asked)))
    assert not fingerprint._same(driven("sumo", "u-turn"), known)
    Changed.size = 1e-6
    assert fingerprint._same(driven("sumo", "u-turn"), known)


def test_a_learner_that_learns_otherwise_is_named_before_a_sweep_begins(monkeypatch) -> None:
    agents = [("dqn", {"network": "dueling"}), ("sb3-ppo", {}), ("mine.py:own", {"network": "attention"})]
    check_learners(agents)
    monkeypatch.setattr("agents.dqn.DQNConfig.rate", lambda self, update: -self.learning_rate)
    with pytest.raises(UserError, match="learner dqn dueling does not learn"):
        check_learners(agents)


def test_what_has_no_fingerprint_is_not_checked() -> None:
    """What behaves otherwise is named before anything is driven: tests/experiments/test_rare.py."""
    check_dynamics([("highway-env", "u-turn"), ("sumo", "a task of the user's own")])


def test_of_a_new_task_the_simulators_that_have_it_are_added_alone(monkeypatch, tmp_path) -> None:
    path = tmp_path / "fingerprints.json"
    path.write_text('{"sumo": {"highway": {"name": "1", "behaviour": {"x": "2"}}}}')
    monkeypatch.setattr(fingerprint, "TABLE", path)
    monkeypatch.setattr(fingerprint, "driven", lambda backend, task: {"level 1": f"{len(backend)} 0.5"})
    monkeypatch.setitem(TASKS, "own", TASKS["u-turn"])  # on no simulator
    assert fingerprint.main(["merge", "own"]) == 0
    table = fingerprint._table()
    assert {part: list(own) for part, own in table.items()} == {
        "sumo": ["highway", "merge"],
        "replica": ["merge"],
        "highway-env": ["merge"],
    }
    assert table["sumo"]["highway"]["name"] == "1"
    with pytest.raises(UserError, match="merge"):
        fingerprint.main(["merg"])


def cells(*tasks: str) -> list[dict[str, Any]]:
    """Records of cells of today."""
    keys = [{"task": task, "backend": "sumo", "dynamics": known_dynamics("sumo", task)} for task in tasks]
    return [{"key": key, "versions": {"libsumo": installed("libsumo"), "torch": "2"}} for key in keys]


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
