"""The agent's side of a task, as a function of the configuration alone; and what is given to several environments.

Separate from the environment because the backend highway-env of the experiments uses it as well.
"""

import reprlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from sumo_env.config import MEASURED, Config, ConfigError, warn_once
from sumo_env.spaces.actions import ActionType, ContinuousAction, action_type
from sumo_env.spaces.grayscale import Grayscale
from sumo_env.spaces.leaders_followers import LeadersFollowers
from sumo_env.spaces.lidar import Lidar
from sumo_env.spaces.observation import ExitObservation, Kinematics, TimeToCollision
from sumo_env.spaces.occupancy import OccupancyGrid
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import TARGET_SPEEDS, Task
from sumo_env.unsupported import page

ObservationType = Kinematics | TimeToCollision | OccupancyGrid | Grayscale | Lidar | LeadersFollowers


class Interface(NamedTuple):
    """What the spaces of a task are made of."""

    action_type: ActionType  # makes the commands
    observation_type: ObservationType  # makes the observations


def interface(task: Task, config: Config, steers: bool = False) -> Interface:
    """The interface of a task under a resolved configuration; steers: whether its simulator can steer the ego.

    Raises:
        ConfigError: the reward cannot be normalised, the entry of the action or of the observation is malformed, or the
            simulator has no use for it.
    """
    if config["drivers"] == MEASURED and (steers or task.of_files):
        raise ConfigError("'drivers' can only be 'highway-env' here: measured drivers are for sumo/*")
    kind = action_type(config["action"], task.target_speeds, steers)
    if isinstance(kind, ContinuousAction) and kind.lateral and not steers and task.name in TASKS:
        warn_once(
            f"{config['action']['type']!r} on sumo/*: its lateral number changes lanes (left below -1/3, right above "
            f"1/3); in highway-env and on replica/* it steers ({page('control')})"
        )
    own, asked = task.target_speeds, config["action"].get("target_speeds")
    if task.reference and kind.names and asked is None and own != TARGET_SPEEDS:
        has = f"config['action'] without 'target_speeds' has those of {task.name!r}, {own} m/s"
        warn_once(f"{has}; in highway-env {TARGET_SPEEDS} ({page('control')})")
    if (limits := task.scale(config)) and limits[0] == limits[1]:
        raise ConfigError(
            f"the reward cannot be normalised: by its weights it is always {limits[0]:g}; change 'collision_reward', "
            "say, or set 'normalize_reward' to False"
        )
    road = task.road(config)
    observation: ObservationType
    given = config["observation"]
    if given["type"] == "Kinematics":
        observation = Kinematics(
            {**task.table, **given}, road.count(*task.ego_road), on_its_way=task.of_files
        )
    elif given["type"] == "ExitObservation":
        observation = ExitObservation(given, road.count(*task.ego_road), road)
    elif given["type"] == "OccupancyGrid":
        observation = OccupancyGrid(given)
    elif given["type"] == "GrayscaleObservation":
        observation = Grayscale(given, config)
    elif given["type"] == "LidarObservation":
        observation = Lidar(given, own_axes=task.of_files)
    elif given["type"] == "LeadersFollowers":
        observation = LeadersFollowers(given, on_its_way=task.of_files)
    elif not kind.names:
        raise ConfigError(f"'TimeToCollision' needs target speeds: {config['action']['type']!r} has none")
    else:
        observation = TimeToCollision(given, config["policy_frequency"])
    return Interface(kind, observation)


def seeds_of(envs: VectorEnv, seed: int | Sequence[int | None] | None) -> list[int | None]:
    """A seed for each environment: an integer means seed, seed + 1, ...; ValueError: too many or too few."""
    _refuse_closed(envs)
    if seed is None or isinstance(seed, int | np.integer):
        return [None if seed is None else int(seed) + index for index in range(envs.num_envs)]
    if isinstance(seed, str) or not hasattr(seed, "__len__") or len(seed) != envs.num_envs:
        raise ValueError(f"an integer or {envs.num_envs} seeds are needed, not {reprlib.repr(seed)}")
    return list(seed)


def actions_of(envs: VectorEnv, actions: Any) -> NDArray[Any]:
    """One action for each environment; ValueError if they are none. Whether numbers are actions is looked at later."""
    _refuse_closed(envs)
    actions = np.asarray(actions)
    if isinstance(envs.single_action_space, gym.spaces.Box):
        known = actions.shape == envs.action_space.shape
    else:
        known = np.issubdtype(actions.dtype, np.integer) and envs.action_space.contains(actions)
    if not known:
        raise ValueError(f"actions must be {envs.num_envs} of {envs.single_action_space}, not {actions}")
    return actions


def _refuse_closed(envs: VectorEnv) -> None:
    if envs.closed:
        raise gym.error.ClosedEnvironmentError(f"{envs} is closed: make another one")
