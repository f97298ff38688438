"""What an agent is offered: observation, action space and speed ladder, as a function of the configuration alone.

Kept apart from the environment so that a process that only steers workers (`vector`) need not load SUMO.
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
    """The agent's side of a task.

    Attributes:
        actions: meta-actions by index.
        target_speeds: the ego's ladder [m/s].
        observation_type: makes the observations.
        observation_space, action_space: gymnasium's.
    """

    actions: dict[int, str]
    target_speeds: tuple[float, ...]
    observation_type: Kinematics | TimeToCollision
    observation_space: spaces.Space[Any]
    action_space: spaces.Space[Any]


def interface(task: Task, config: Config) -> Interface:
    """The interface of a task under a resolved configuration.

    Raises:
        ConfigError: the ladder does not rise, or the observation's entry is malformed.
    """
    actions = action_names(config["action"])
    ladder = config["action"].get("target_speeds") or task.target_speeds
    try:
        speeds = tuple(float(speed) for speed in ladder)
    except (TypeError, ValueError):
        speeds = ()
    if len(speeds) < 2 or any(low >= high for low, high in pairwise(speeds)):
        raise ConfigError(f"'target_speeds' must be at least two rising speeds [m/s], not {ladder!r}")
    road = task.road(config)
    observation: Kinematics | TimeToCollision
    if config["observation"]["type"] == "Kinematics":
        observation = Kinematics(config["observation"], road.count(*task.ego_road))
    else:
        observation = TimeToCollision(config["observation"], config["policy_frequency"])
    return Interface(actions, speeds, observation, observation.space, spaces.Discrete(len(actions)))
