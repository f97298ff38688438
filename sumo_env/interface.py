"""The agent's side of a task: observation, action space and target speeds, as a function of the configuration alone.

Separate from the environment because the backend highway-env of the experiments uses it as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from gymnasium import spaces

from sumo_env.actions import action_names
from sumo_env.config import Config, ConfigError
from sumo_env.observation import Kinematics, TimeToCollision
from sumo_env.tasks.base import Task


@dataclass(frozen=True)
class Interface:
    """Observation and action space of a task, and what they are made of."""

    actions: dict[int, str]  # meta-actions by index
    target_speeds: tuple[float, ...]  # that the ego can be commanded, rising [m/s]
    observation_type: Kinematics | TimeToCollision  # makes the observations
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]


def interface(task: Task, config: Config) -> Interface:
    """The interface of a task under a resolved configuration.

    Raises:
        ConfigError: the target speeds do not rise, the reward cannot be normalised, or the entry of the observation
            is malformed.
    """
    actions = action_names(config["action"])
    ladder = config["action"].get("target_speeds") or task.target_speeds
    try:
        speeds = tuple(float(speed) for speed in ladder)
    except (TypeError, ValueError):
        speeds = ()
    if len(speeds) < 2 or any(low >= high for low, high in pairwise(speeds)):
        raise ConfigError(f"'target_speeds' must be at least two rising speeds [m/s], not {ladder!r}")
    limits = task.reward_limits(config)
    if limits and config["normalize_reward"] and limits[0] == limits[1]:
        raise ConfigError(
            f"the reward cannot be normalised: the weights make {limits[0]:g} both its least and its largest value; "
            "change 'collision_reward' or another weight, or set 'normalize_reward' to False"
        )
    road = task.road(config)
    observation: Kinematics | TimeToCollision
    if config["observation"]["type"] == "Kinematics":
        observation = Kinematics(config["observation"], road.count(*task.ego_road))
    else:
        observation = TimeToCollision(config["observation"], config["policy_frequency"])
    return Interface(actions, speeds, observation, observation.space, spaces.Discrete(len(actions)))
