"""Training of a cell: the traffic and scenarios that an arm meets, and the same bits after an interruption."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from agents.checkpoint import load_arrays
from agents.streams import episode_seed
from experiments.study.arms import TEST, drawn_dose, scenario_seed, training_seed
from experiments.study.cell import CellTask
from experiments.study.experiment import Experiment
from experiments.study.grid import Cell
from experiments.study.store import EPISODES, GATES, TRAINING, WEIGHTS, Store
from experiments.study.train import train_cell
from tests.experiments.fake_env import FakeEnv, make_env

PROFILE = {"network": "dueling", "updates": 60, "steps_per_update": 2, "warm_up": 40, "batch_size": 8}


def cell(arm: str, **profile: object) -> Cell:
    asked = Experiment(
        tasks=("u-turn",),
        levels=(1,),
        seeds=1,
        episodes=3,
        arms=(arm,),
        learners={"u-turn": {**PROFILE, **profile}},
        first_seed=2,
        first_scenario=50,
    )
    return replace(asked.cells()[0], env_config={"duration": 10})


class Interrupted(Exception):
    pass


@pytest.fixture
def met(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, float]]:
    """Seed and dose of every episode that begins."""
    found, reset = [], FakeEnv.reset

    def noting(self, *, seed=None, options=None):
        result = reset(self, seed=seed, options=options)
        found.append((seed, self.config["risk"]))
        return result

    monkeypatch.setattr(FakeEnv, "reset", noting)
    return found


@pytest.mark.parametrize(("arm", "dose"), [("control", 0.0), ("treatment", 1.0)])
def test_an_arm_differs_by_the_traffic_of_its_training_alone(arm, dose, tmp_path, met) -> None:
    CellTask(cell(arm), tmp_path, make_env).compute(lambda _: None)
    tests, gates = (
        {scenario_seed("u-turn", 1, k, purpose) for k in (50, 51, 52)} for purpose in ("test", "gate")
    )
    assert tests.isdisjoint(gates)
    assert {risk for seed, risk in met if seed < TEST} == {dose}
    in_tests = {(seed, risk) for seed, risk in met if seed in tests}
    assert in_tests == {(seed, risk) for seed in tests for risk in (0.0, 1.0)}
    assert {(seed, risk) for seed, risk in met if seed in gates} == {(seed, dose) for seed in gates}
    assert {seed for seed, _ in met if seed >= TEST} == tests | gates


@pytest.mark.parametrize("arm", ["mixed", "drawn"])
def test_a_drawn_dose_is_met_logged_and_the_same_after_an_interruption(
    arm, tmp_path, met, monkeypatch
) -> None:
    def stop(updates: int) -> None:
        if updates >= 40:
            raise Interrupted

    monkeypatch.setattr("experiments.study.train.MIN_INTERVAL", 20)
    clock = {"training_clock": [13, 13]}
    whole_folder, resumed_folder = tmp_path / "whole", tmp_path / "resumed"
    whole = train_cell(cell(arm, **clock), make_env("sumo", "u-turn", {"duration": 13}), whole_folder)
    seed = training_seed("u-turn", 1, 2)
    expected = [drawn_dose(arm, episode_seed(seed, k)) for k in range(len(whole.episodes))]
    assert [dose for _, dose in met] == expected == whole.episodes["risk"].tolist()
    assert len(set(expected)) == (2 if arm == "mixed" else len(expected))
    assert whole.episodes["length"].max() > 10

    with pytest.raises(Interrupted):
        train_cell(cell(arm, **clock), make_env("sumo", "u-turn", {"duration": 13}), resumed_folder, stop)
    met.clear()
    resumed = train_cell(cell(arm, **clock), make_env("sumo", "u-turn", {"duration": 13}), resumed_folder)
    assert 0 < len(met) < 0.8 * len(expected)  # it goes on and does not begin again
    assert resumed.policy.sha256 == whole.policy.sha256
    assert resumed.episodes.equals(whole.episodes)


def test_an_agent_that_observes_the_dose_is_trained_and_tested_with_it(tmp_path: Path) -> None:
    task = CellTask(cell("mixed-seen"), tmp_path, make_env)
    task.compute(lambda _: None)
    weights = load_arrays(Store(tmp_path).cells / task.name / WEIGHTS)
    assert weights["mean"].shape == (2, 6)  # five features and the dose
    assert weights["deviation"][0, -1] == pytest.approx(0.5, abs=0.05)


def test_tests_keep_their_own_clock_and_doses(tmp_path: Path) -> None:
    task = CellTask(cell("mixed", training_clock=[13, 13], finite_horizon=False), tmp_path, make_env)
    assert task.cell.training_config == {"duration": 13}
    task.compute(lambda _: None)
    stored = Store(tmp_path).tables(task.name)
    assert stored[EPISODES]["length"].max() <= 10
    assert set(stored[EPISODES]["scenario"]) == {50, 51, 52}
    assert set(stored[GATES]["scenario"]) == {50, 51, 52}
    training = stored[TRAINING]
    assert training["length"].max() > 10 and set(training["risk"]) == {0.0, 1.0}
