"""Training of a cell: the traffic and scenarios that an arm meets, and the same bits twice."""

from dataclasses import replace
from itertools import product
from typing import Any

import pandas as pd
import pytest

from agents.learner import Trained
from agents.streams import episode_seed
from experiments.study.compute.cells import CellTask
from experiments.study.compute.train import CURVE, learning_curve, train_cell
from experiments.study.design.arms import EVERY_ARM, TEST, scenario_seed, training_seed
from experiments.study.design.cell import Cell
from tests.agents.networks import weights
from tests.experiments.fake_env import FakeEnv, make_env
from tests.experiments.study.test_experiment import cells

PROFILE = {"network": "dueling", "updates": 60, "steps_per_update": 2, "warm_up": 40, "batch_size": 8}


def cell(arm: str, **profile: object) -> Cell:
    few: dict[str, Any] = {"seeds": 1, "episodes": 3, "gate_episodes": 3, "arms": (arm,)}
    few |= {"first_seed": 2, "first_scenario": 50, "learners": lambda _: {**PROFILE, **profile}}
    [one, *_] = cells({"u-turn": (1,)}, **few)
    return replace(one, env_config={"duration": 10})


@pytest.fixture
def met() -> list[tuple[int, float, int]]:
    """Seed, dose and duration of every episode that begins."""
    FakeEnv.met.clear()
    return FakeEnv.met


@pytest.mark.parametrize(("arm", "doses"), [("control", {0.0}), ("treatment", {1.0}), ("mixed", {0.0, 1.0})])
def test_an_arm_differs_by_the_traffic_of_its_training_alone(arm, doses, tmp_path, met) -> None:
    """Tests have both traffics, gates those of the training, and both their own clock."""
    CellTask(cell(arm, training_clock=[13, 13]), tmp_path, make_env).compute(lambda _: None)
    tests, gates = (
        {scenario_seed("u-turn", 1, k, purpose) for k in (50, 51, 52)} for purpose in ("test", "gate")
    )
    assert tests.isdisjoint(gates)
    asked = set(product(tests, (0.0, 1.0), (10,))) | set(product(gates, doses, (10,)))
    assert {episode for episode in met if episode[0] >= TEST} == asked
    assert {episode[1:] for episode in met if episode[0] < TEST} == set(product(doses, (13,)))


def test_a_drawn_dose_is_met_logged_and_the_same_again(met) -> None:
    def trained() -> tuple[Trained, pd.DataFrame, dict[str, Any]]:
        return train_cell(cell("mixed", training_clock=[13, 13]), make_env, lambda _: None)

    whole, episodes, record = trained()
    assert record["steps"] >= 160
    seed = training_seed("u-turn", 1, 2)
    expected = [EVERY_ARM["mixed"].traffic.dose_of(episode_seed(seed, k)) for k in range(len(episodes))]
    assert [dose for _, dose, _ in met] == expected == episodes["risk"].tolist()
    assert len(set(expected)) == 2

    again, log, _ = trained()
    assert weights(again.policy) == weights(whole.policy)
    assert log.equals(episodes)


def test_a_learning_curve_is_of_equal_parts_of_the_steps() -> None:
    """Two episodes in each part, the second one at its end; in the sixth none ends."""
    steps = [step for k in range(CURVE) if k != 5 for step in (100 * k + 50, 100 * k + 100)]
    episodes = {
        "step": steps,
        "return": [step / 100 for step in steps],
        "crashed": [step % 100 > 0 for step in steps],
    }
    curve = learning_curve(episodes)
    assert curve["step"] == [100 * k for k in range(1, CURVE + 1)]
    assert curve["return"] == [None if k == 5 else k + 0.75 for k in range(CURVE)]
    assert curve["crashed"] == [None if k == 5 else 0.5 for k in range(CURVE)]
