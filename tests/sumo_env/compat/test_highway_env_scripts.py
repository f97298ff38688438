"""Scripts as users of highway-env publish them, written anew in a few lines each, with ``sumo/`` before the id.

Each test is one kind of script that was found in public repositories. What is checked is that it runs to its end.
"""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import FlattenObservation

from sumo_env.config import ConfigError, warn_once
from sumo_env.envs import HighwayEnv, IntersectionEnv

FEW = {"vehicles_count": 6, "duration": 4}


class OwnReward(HighwayEnv):
    """A reward of one's own, with its weights in the configuration."""

    @classmethod
    def default_config(cls) -> dict[str, Any]:
        config = super().default_config()
        config.update({**FEW, "lanes_count": 3, "gap_reward": 0.3, "tailgating_reward": -0.5})
        return config

    def _rewards(self, action: int | None) -> dict[str, float]:
        front, _ = self.road.neighbour_vehicles(self.vehicle, self.vehicle.lane_index)
        gap = self.vehicle.lane_distance_to(front) if front else 100.0
        own = {"gap_reward": float(np.clip(gap / 100.0, 0, 1)), "tailgating_reward": float(gap < 10.0)}
        return {**super()._rewards(action), **own}

    def _reward(self, action: int) -> float:
        return sum(self.config.get(name, 0) * reward for name, reward in self._rewards(action).items())

    def _is_terminated(self) -> bool:
        return self.vehicle.crashed or not self.vehicle.on_road

    def _is_truncated(self) -> bool:
        return self.time >= self.config["duration"]


def test_a_subclass_has_its_own_reward_and_id() -> None:
    gym.register(id="own-reward-v0", entry_point=f"{__name__}:OwnReward")
    env: Any = gym.make("own-reward-v0")
    env.reset(seed=1)
    weights, truncated = env.unwrapped.config, False
    for _ in range(4):
        _, reward, terminated, truncated, info = env.step(env.unwrapped.action_type.actions_indexes["IDLE"])
        assert info["rewards"].keys() >= {"gap_reward", "tailgating_reward", "collision_reward"}
        assert reward == pytest.approx(sum(weights.get(key, 0) * one for key, one in info["rewards"].items()))
        assert terminated == (info["crashed"] or not info["on_road"])
    assert truncated and len(env.unwrapped.road.vehicles) == 1 + FEW["vehicles_count"]
    with pytest.raises(ConfigError, match="did you mean 'gap_reward'"):
        env.unwrapped.configure({"gap_rewards": 7.0})


class Arrival(IntersectionEnv):
    """A copy of the idea of goals: the observation is flat, and `info` counts."""

    def define_spaces(self) -> None:
        super().define_spaces()
        self.action_space = gym.spaces.Discrete(3)

    def _info(self, obs: Any, action: Any = None) -> dict[str, Any]:
        near = self.road.close_vehicles_to(self.vehicle, 20.0, see_behind=True)
        own = {"near": len(near), "is_success": self.task.arrived(self.ego_state)}
        return {**super()._info(obs, action), **own}


def test_a_subclass_of_the_intersection_tells_more() -> None:
    env = FlattenObservation(Arrival({"observation": {"type": "OccupancyGrid"}, "duration": 3}))
    observation, info = env.reset(seed=0)
    assert observation.ndim == 1 and info["near"] >= 0
    assert not env.step(1)[4]["is_success"]


@pytest.mark.parametrize("road", ["highway", "roundabout", "intersection"])
def test_one_configuration_serves_several_roads(road: str, recwarn: pytest.WarningsRecorder) -> None:
    """Keys of other roads and of other versions, also within an observation and an action; the latest id first."""
    config: dict[str, Any] = {
        "observation": {"type": "Kinematics", "vehicles_count": 8, "absolute": True, "normalize": False,
                        "features_range": {"x": [-120, 120]}, "see_ego": True},
        "action": {"type": "DiscreteMetaAction", "actions": ["IDLE", "FASTER", "SLOWER"]},
        "lanes_count": 2, "vehicles_count": 5, "ego_spacing": 2, "duration": 2, "reward_speed_range": [20, 30],
        "right_lane_reward": 0.1, "normalize_reward": True, "offroad_terminal": False,
    }  # fmt: skip
    try:
        env: Any = gym.make(f"sumo/{road}-v9")
    except gym.error.VersionNotFound:
        env = gym.make(f"sumo/{road}-v0")
    warn_once.cache_clear()
    env.unwrapped.configure(config)
    observation, _ = env.reset(seed=1)
    assert env.observation_space.contains(observation) and len(observation) == 8
    while not any(env.step(env.action_space.sample())[2:4]):
        pass
    told = " ".join(str(warned.message) for warned in recwarn)
    assert "'see_ego' has no effect" in told and "'actions' has no effect" in told
    with pytest.raises(ConfigError, match="did you mean 'absolute'"):
        env.unwrapped.configure({"observation": {**config["observation"], "absolut": True}})
