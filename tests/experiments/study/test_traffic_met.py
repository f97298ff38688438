"""Which traffic and which scenarios an agent meets, in training, in the test and for its gates."""

from __future__ import annotations

from dataclasses import replace

import pytest

from experiments.study.arms import TEST, scenario_seed
from experiments.study.cell import CellTask
from experiments.study.experiment import Experiment
from tests.experiments.fake_env import FakeEnv, make_env

PROFILE = {"network": "dueling", "updates": 20, "steps_per_update": 2, "warm_up": 20, "batch_size": 8}
EPISODES = 3


@pytest.mark.parametrize(("arm", "dose"), [("control", 0.0), ("treatment", 1.0)])
def test_an_arm_differs_by_the_traffic_of_its_training_alone(arm, dose, tmp_path, monkeypatch) -> None:
    met: list[tuple[int, float]] = []
    reset = FakeEnv.reset

    def noting(self, *, seed=None, options=None):
        result = reset(self, seed=seed, options=options)
        met.append((seed, self.config["risk"]))
        return result

    monkeypatch.setattr(FakeEnv, "reset", noting)
    asked = {"tasks": ("u-turn",), "levels": (1,), "seeds": 1, "episodes": EPISODES, "arms": (arm,)}
    cell = replace(Experiment(**asked, learners={"u-turn": PROFILE}).cells()[0], env_config={"duration": 10})
    CellTask(cell, tmp_path, make_env).compute(lambda _: None)

    tests, gates = (
        {scenario_seed("u-turn", 1, k, purpose) for k in range(EPISODES)} for purpose in ("test", "gate")
    )
    assert tests.isdisjoint(gates)
    assert {risk for seed, risk in met if seed < TEST} == {dose}
    assert {(seed, risk) for seed, risk in met if seed in tests} == {
        (s, r) for s in tests for r in (0.0, 1.0)
    }
    assert {(seed, risk) for seed, risk in met if seed in gates} == {(s, dose) for s in gates}
    assert {seed for seed, _ in met if seed >= TEST} == tests | gates
