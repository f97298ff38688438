"""Our roads, rewards and endings against highway-env's own, on states of highway-env."""

from __future__ import annotations

from contextlib import closing
from random import Random
from typing import Any

import numpy as np
import pytest

from experiments.backends.highway_env import ScenarioEnv
from sumo_env.env import DrivingEnv
from sumo_env.tasks import TASKS
from tests.sumo_env.parity import ego_state, make, scatter
from tests.sumo_env.rollout import drive
from tests.tasks import OF_HIGHWAY_ENV, every_task, highway_env_task

WEIGHTS: dict[str, dict[str, Any]] = {
    "highway": {
        "right_lane_reward": 0.3,
        "reward_speed_range": [15, 28],
        "lanes_count": 3,
        "offroad_terminal": True,
    },
    "two-way": {"left_lane_reward": 0.5, "high_speed_reward": 0.3},
    "roundabout": {"lane_change_reward": -0.2, "high_speed_reward": 0.5},
    "intersection": {"collision_reward": -2, "arrived_reward": 3, "offroad_terminal": True},
    "u-turn": {"left_lane_reward": 0.4, "collision_reward": -3},
    "merge": {"merging_speed_reward": -0.7, "reward_speed_range": [18, 27]},
    "exit": {"goal_reward": 0.6, "right_lane_reward": 0.2, "collision_reward": -2, "lanes_count": 4},
}


LADDER = {"action": {"type": "DiscreteMetaAction", "target_speeds": [5, 10, 15, 20, 25]}}


def assert_same_judgement(env: ScenarioEnv, action: int) -> dict[str, bool]:
    """Of the present state, as at the end of a step; returns what highway-env says of it."""
    env.steps, env.scene = 1, env._scene()  # at a reset there is no action
    info, state, task = env._info(np.empty(0), action), ego_state(env, action), env.task
    rewards = task.rewards(state, env.config)
    assert rewards == pytest.approx({k: float(v) for k, v in env._rewards(action).items()}, abs=1e-9)
    assert task.reward(rewards, env.config) == pytest.approx(float(env._reward(action)), abs=1e-9)
    assert task.terminated(state, env.config) == bool(env._is_terminated())
    assert task.arrived(state) == info["arrived"]
    assert state.on_road == info["on_road"]
    return {name: info[name] for name in ("on_road", "crashed", "arrived")}


@pytest.mark.parametrize("normalize", [True, False])
@pytest.mark.parametrize("changed", ["nothing", "weights", "ladder"])
@highway_env_task
def test_equal_in_random_states(task: str, changed: str, normalize: bool) -> None:
    chosen = {"nothing": {}, "weights": dict(WEIGHTS[task]), "ladder": dict(LADDER)}[changed]
    if "normalize_reward" in TASKS[task].defaults:
        chosen["normalize_reward"] = normalize
    elif not normalize:
        pytest.skip("there is no such key")
    env = make(task, **chosen)
    env.reset(seed=1)
    env.road.vehicles = [env.vehicle]
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(100):
        scatter(env, rng)
        if task == "two-way" and env.vehicle.lane_index[0] == "b":
            continue  # highway-env divides by zero when the ego has turned round
        if env.vehicle.lane_index == ("b", "c", 2):
            continue  # nobody may change to it, and the ego does not begin there
        seen |= {*assert_same_judgement(env, int(rng.integers(env.action_space.n))).items()}
    assert len(seen) == (6 if task in ("intersection", "exit", "merge") else 5)  # where one arrives


ALONE = dict.fromkeys(
    ("vehicles_count", "initial_vehicle_count", "oncoming_vehicles_count", "spawn_probability"), 0
)


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
                if (
                    terminated
                ):  # at the intersection one car always crosses; a task of our own may have others
                    own = task == "intersection" or task not in OF_HIGHWAY_ENV
                    assert not info["crashed"] or own, where
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
