"""Published folders are whole, and the configurations and dynamics in their keys are today's.

That a name is the hash of a cell's key is checked whenever it is read.
"""

from __future__ import annotations

import json
import subprocess
from functools import cache
from typing import Any

import gymnasium as gym
import pytest

from experiments.backends import BACKENDS, make_env
from experiments.study.design import fingerprint
from experiments.study.design.fingerprint import check_dynamics, check_learners, driven, dynamics
from experiments.study.design.grid import BACKEND_KEYS
from experiments.study.results.store import Store
from experiments.support.errors import UserError
from experiments.support.files import canonical_json
from sumo_env.config import resolve
from sumo_env.tasks import TASKS
from tests.golden.numbers import PUBLISHED, RESULTS


@cache
def cells(folder: str) -> dict[str, dict[str, Any]]:
    return Store(RESULTS / folder).records()


@pytest.mark.parametrize("folder", PUBLISHED)
def test_every_packed_table_of_a_published_folder_is_here(folder: str) -> None:
    listed = json.loads((RESULTS / folder / "packed.json").read_text())["files"]
    assert [file for file in listed if not (RESULTS / folder / file).is_file()] == []
    Store(RESULTS / folder).tables(next(iter(cells(folder))))


@pytest.mark.parametrize("folder", PUBLISHED)
def test_the_configuration_of_published_cells_is_accepted(folder: str) -> None:
    stored = {canonical_json([c["key"]["task"], c["key"]["env_config"]]) for c in cells(folder).values()}
    for task, config in map(json.loads, stored):
        resolve(task, TASKS[task].defaults, {k: v for k, v in config.items() if k not in BACKEND_KEYS})


def test_the_dynamics_of_published_cells_are_those_of_today() -> None:
    stored = set()
    for cell in (cell for folder in PUBLISHED for cell in cells(folder).values()):
        for key in (cell["key"], {**cell["key"], **cell["key"].get("test_on", {})}):
            stored.add((key["backend"], key["task"], key["dynamics"]))
    assert stored == {(backend, task, dynamics(backend, task)) for backend in BACKENDS for task in TASKS}


@pytest.mark.parametrize("backend", ["sumo", "replica"])
@pytest.mark.parametrize("task", TASKS)
def test_the_simulators_do_what_they_did(backend: str, task: str) -> None:
    check_dynamics([(backend, task)])


@pytest.mark.parametrize("risk", [0.0, 1.0])
def test_a_change_in_the_middle_of_an_episode_is_noticed_at_either_dose(risk: float, monkeypatch) -> None:
    """And one that other processors might make is not."""
    usual = driven("sumo", "u-turn")

    class Changed(gym.Wrapper):
        size = 0.1

        def step(self, action: int) -> Any:
            observation, reward, *rest = self.env.step(action)
            inner: Any = self.unwrapped
            is_later = inner.scene.time > 4 and inner.config["risk"] == risk
            return observation, float(reward) + self.size * is_later, *rest

    name = "experiments.study.design.fingerprint.make_env"
    monkeypatch.setattr(name, lambda *asked: Changed(make_env(*asked)))
    assert not fingerprint._same(driven("sumo", "u-turn"), usual)
    Changed.size = 1e-6
    assert fingerprint._same(driven("sumo", "u-turn"), usual)


def test_a_learner_that_learns_otherwise_is_named_before_a_sweep_begins(monkeypatch) -> None:
    agents = [("dqn", {"network": "dueling"}), ("sb3-ppo", {}), ("mine.py:own", {"network": "attention"})]
    check_learners(agents)
    monkeypatch.setattr("agents.dqn.DQNConfig.rate", lambda self, update: -self.learning_rate)
    with pytest.raises(UserError, match="learner dqn dueling does not learn"):
        check_learners(agents)


def test_a_simulator_that_behaves_otherwise_is_named_before_a_sweep_begins(monkeypatch) -> None:
    check_dynamics([("sumo", "u-turn"), ("highway-env", "u-turn"), ("sumo", "a task of the user's own")])
    rates = TASKS["u-turn"].risk_rates
    monkeypatch.setattr(type(TASKS["u-turn"]), "risk_rates", type(rates)(brake=1.0))
    with pytest.raises(UserError, match="task u-turn on the backend sumo does not behave"):
        check_dynamics([("sumo", "u-turn")])


@pytest.mark.slow
def test_highway_env_does_what_it_did() -> None:
    check_dynamics(("highway-env", task) for task in TASKS)


def test_the_published_folders_have_few_files() -> None:
    # results/second-rest is not published: the folder holds single cells until these are packed.
    command = ["git", "-C", str(RESULTS), "ls-files", ".", ":!second-rest"]
    listed = subprocess.run(command, capture_output=True, text=True, check=False)
    if listed.returncode:
        pytest.skip("not a checkout")
    assert 0 < len(listed.stdout.splitlines()) <= 120
