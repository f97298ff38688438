"""What users of highway-env and rl-agents bring: configurations, and scripts that read its objects."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from sumo_env.config import Config
from sumo_env.env import DrivingEnv
from tests.sumo_env.parity import stock
from tests.tasks import highway_env_task

# Environments of rl-agents' scripts/configs, by file.
RL_AGENTS: dict[str, tuple[str, Config]] = {
    "HighwayEnv/env_obs_attention": (
        "highway",
        {
            "lanes_count": 3, "vehicles_count": 15, "policy_frequency": 2, "duration": 40,
            "observation": {
                "type": "Kinematics", "vehicles_count": 15, "absolute": False,
                "features": ["presence", "x", "y", "vx", "vy", "cos_h", "sin_h"],
                "features_range": {"x": [-100, 100], "y": [-100, 100], "vx": [-20, 20], "vy": [-20, 20]},
            },
        },
    ),
    "IntersectionEnv/env_5fps": (
        "intersection",
        {"policy_frequency": 5, "show_history": False, "destination": "o1", "duration": 15},
    ),
    "TwoWayEnv/env": (
        "two-way", {"screen_height": 300, "observation": {"type": "TimeToCollision", "horizon": 5}}
    ),
}  # fmt: skip


@pytest.fixture
def highway() -> Iterator[DrivingEnv]:
    with closing(DrivingEnv("highway", {"vehicles_count": 10, "initial_lane_id": 0})) as env:
        env.reset(seed=0)
        yield env


# -- configurations ----------------------------------------------------------------------------------------


@highway_env_task
def test_the_whole_configuration_of_highway_env_is_accepted(task: str, recwarn) -> None:
    """In silence, and what it says is what the environment then has."""
    theirs = stock(task).default_config()
    env = DrivingEnv(task, theirs)
    observation, _ = env.reset(seed=0)
    assert env.observation_space.contains(observation)
    shared = theirs.keys() & env.config.keys()
    assert {key for key in shared if env.config[key] != theirs[key]} == set()
    assert env.config["simulation_frequency"] == 15
    env.step(1)
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.parametrize("name", RL_AGENTS)
def test_configurations_of_rl_agents_are_accepted(name: str, recwarn: pytest.WarningsRecorder) -> None:
    """As its ``load_environment`` hands them over: the whole file, to ``configure`` and then ``reset``."""
    task, config = RL_AGENTS[name]
    env = gym.make(f"sumo/{task}-v0", render_mode="rgb_array")
    file = json.dumps({"id": f"{task}-v0", "import_module": "highway_env", **config})
    env.get_wrapper_attr("configure")(json.loads(file))
    observation, _ = env.reset()
    assert env.observation_space.contains(observation)  # of the wrapped environment
    assert [str(w.message) for w in recwarn if "env.reset()" not in str(w.message)] == []


def test_numbers_may_be_numpys() -> None:
    env = DrivingEnv(
        "highway",
        {
            "vehicles_count": np.int64(5),
            "risk": np.float32(0.5),
            "normalize_reward": np.bool_(False),
            "reward_speed_range": np.array([10.0, 20.0]),
            "observation": {"type": "Kinematics", "vehicles_count": np.int32(3)},
        },
    )
    assert env.reset(seed=0)[0].shape == (3, 5)
    json.dumps(env.config)
    env.config["vehicles_count"] = np.int16(4)
    env.reset(seed=0)
    assert len(env.scenario.vehicles) == 4


def test_coarse_steps_are_refined() -> None:
    """With steps of half a second, cars would pass through each other."""
    env = DrivingEnv("highway", {"simulation_frequency": 2, "policy_frequency": 2, "duration": 2})
    env.reset(seed=0)
    assert env.scenario.simulation_frequency == 6
    assert [env.step(1)[3] for _ in range(4)] == [False, False, False, True]
    assert env.scene.time == pytest.approx(2.0)


# -- what scripts read -------------------------------------------------------------------------------------


def test_available_actions_are_those_that_change_something(highway: DrivingEnv) -> None:
    """In the left lane there is nothing to the left; at the top speed nothing is faster."""
    names = highway.action_type.actions_indexes
    assert highway.vehicle.lane_index == ("0", "1", 0)
    available = [names[n] for n in ("IDLE", "LANE_RIGHT", "FASTER", "SLOWER")]
    assert sorted(highway.get_available_actions()) == available
    highway.step(names["FASTER"])
    ego: Any = highway.vehicle
    assert ego.target_speed == 30.0
    available = highway.action_type.get_available_actions()
    assert sorted(available) == [names[n] for n in ("IDLE", "LANE_RIGHT", "SLOWER")]
