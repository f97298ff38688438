"""An ego that is left alone keeps its lane, in every configuration that is allowed."""

from __future__ import annotations

from contextlib import closing
from random import Random
from typing import Any

import numpy as np
import pytest

from sumo_env.env import DrivingEnv
from tests.sumo_env.rollout import drive
from tests.tasks import every_task

ALONE = {
    "vehicles_count": 0,
    "initial_vehicle_count": 0,
    "oncoming_vehicles_count": 0,
    "spawn_probability": 0,
}


def configuration(task: str, rng: Random) -> dict[str, Any]:
    """A random one, without traffic."""
    policy = rng.choice([1, 2, 5])
    config: dict[str, Any] = {
        "policy_frequency": policy,
        "simulation_frequency": policy * rng.choice([5, 10]) if policy < 5 else rng.choice([5, 10, 15, 20]),
        "duration": rng.uniform(5.0, 40.0),
        "risk": rng.choice([0.0, 1.0]),
    }
    if task == "highway":
        config |= {"lanes_count": rng.randint(1, 6)}
    if task == "two-way":
        config |= {"road_length": rng.uniform(100.0, 1500.0)}
    known = DrivingEnv(task).config
    return config | {key: value for key, value in ALONE.items() if key in known}


@every_task
def test_the_lateral_coordinate_stays(task: str) -> None:
    for seed in range(8):
        config = configuration(task, Random(seed))
        with closing(DrivingEnv(task, config)) as env:
            env.reset(seed=seed)
            (start, end, place), y = env.ego_state.target_lane, env.scene.y[0]
            for *_, terminated, _, info in drive(env, 1):
                where = config, env.scene.time
                if terminated:  # at the intersection one car always crosses
                    assert not info["crashed"] or task == "intersection", where
                    break
                assert abs(env.sumo.vehicle.getLateralLanePosition("ego")) < 0.1, where
                if task in ("highway", "two-way"):  # in and after bends its middle is beside the lane
                    assert env.scene.y[0] == pytest.approx(y, abs=0.1), where
                target = env.ego_state.target_lane
                assert target[:2] != (start, end) or target[2] == place, where
                start, end, place = target


def test_the_two_way_road_goes_on_at_its_end() -> None:
    """Also lane changes there; until then nothing is other than on a longer road."""
    left, idle, right = 0, 1, 2
    driven = []
    for length in (300.0, 800.0):
        config = {"road_length": length, "duration": 30, "vehicles_count": 0, "oncoming_vehicles_count": 0}
        with closing(DrivingEnv("two-way", config)) as env:
            env.reset(seed=0)
            places = [(env.scene.x[0], env.scene.y[0], 0.0)]
            for result in drive(env, [idle] * 12 + [left] + [idle] * 3 + [right] + [idle] * 5):
                places.append((env.scene.x[0], env.scene.y[0], result[1]))
            driven.append(np.array(places))
    assert driven[0][:, 0].max() > 500.0
    np.testing.assert_array_equal(driven[0], driven[1])
    assert driven[0][:13, 1] == pytest.approx(4.0) and driven[0][16, 1] == pytest.approx(0.0, abs=0.1)
    assert driven[0][-1, 1] == pytest.approx(4.0, abs=0.1)
