"""The agent's side of a task, as a function of the configuration alone, the ``info`` of a step, and what is given to
several environments at once.

Separate from the environment because the backend highway-env of the experiments uses it as well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import VectorEnv
from numpy.typing import NDArray

from sumo_env.config import MEASURED, Config, ConfigError, warn_once
from sumo_env.contacts.crash import CrashRecord
from sumo_env.contacts.measures import NEAR_MISS_TTC, density
from sumo_env.not_here import page
from sumo_env.scene import Place, Scene
from sumo_env.spaces.actions import ActionType, ContinuousAction, action_type
from sumo_env.spaces.grayscale import Grayscale
from sumo_env.spaces.neighbours import LeadersFollowers
from sumo_env.spaces.observation import Kinematics, TimeToCollision
from sumo_env.spaces.occupancy import OccupancyGrid
from sumo_env.tasks import TASKS
from sumo_env.tasks.base import EgoState, Task
from sumo_env.tasks.network import NetworkTask

ObservationType = Kinematics | TimeToCollision | OccupancyGrid | Grayscale | LeadersFollowers


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
    if config["drivers"] == MEASURED and (steers or isinstance(task, NetworkTask)):
        raise ConfigError("'drivers' can only be 'highway-env' here: measured drivers are for sumo/*")
    kind = action_type(config["action"], task.target_speeds, steers)
    if isinstance(kind, ContinuousAction) and kind.lateral and not steers and task.name in TASKS:
        warn_once(
            f"{config['action']['type']!r} on sumo/*: its lateral number changes lanes (left below -1/3, right above "
            f"1/3); in highway-env and on replica/* it steers ({page('control')})"
        )
    limits = task.reward_limits(config)
    if limits and config.get("normalize_reward", True) and limits[0] == limits[1]:
        raise ConfigError(
            f"the reward cannot be normalised: by its weights it is always {limits[0]:g}; change 'collision_reward', "
            "say, or set 'normalize_reward' to False"
        )
    road = task.road(config)
    observation: ObservationType
    given, of_network = config["observation"], isinstance(task, NetworkTask)
    if given["type"] == "Kinematics":
        if isinstance(task, NetworkTask):
            given = {**task.table, **given}
        observation = Kinematics(given, road.count(*task.ego_road), on_its_way=of_network)
    elif given["type"] == "OccupancyGrid":
        observation = OccupancyGrid(given)
    elif given["type"] == "GrayscaleObservation":
        observation = Grayscale(given, config)
    elif given["type"] == "LeadersFollowers":
        observation = LeadersFollowers(given, on_its_way=of_network)
    elif not kind.names:
        raise ConfigError(f"'TimeToCollision' needs target speeds: {config['action']['type']!r} has none")
    else:
        observation = TimeToCollision(given, config["policy_frequency"])
    return Interface(kind, observation)


def paid_late() -> float:
    """The reward of a step after the end of an episode, with a warning."""
    gym.logger.warn("this episode is over, and a step after its end pays 0: call reset()")
    return 0.0


def information(
    scene: Scene,
    crash: CrashRecord | None,
    min_ttc: float,
    distance: float,
    *,
    arrived: bool,
    on_road: bool,
    rewards: Mapping[str, float],
    action: Any,
    ending: str,
) -> dict[str, Any]:
    """The ``info`` of a step, or of a reset with the action type's `no_action`; see `DrivingEnv.step`.

    The same keys with values of the same types always, none of them None or NaN, so that libraries can store and merge
    it: without a crash its record is empty, because gymnasium cannot merge None and a record. `min_ttc` is the least
    time to collision before a contact [s].
    """
    crashed = bool(scene.crashed[0])
    info = {
        "speed": float(scene.speed[0]),
        "crashed": crashed,
        "arrived": bool(arrived),
        "on_road": bool(on_road),
        "action": action,
        "rewards": {name: float(value) for name, value in rewards.items()},
        "cost": float(crashed),
        "crash": {} if crash is None else asdict(crash),
        "ending": ending,
        "density": density(scene.x, scene.y),
        "min_ttc": 0.0 if crashed else float(min_ttc),
        "min_ttc_before_contact": float(min_ttc),
        "near_miss": bool(min_ttc < NEAR_MISS_TTC) and not crashed,
        "distance": float(distance),
        "traffic_light": int(scene.light.state),
        "traffic_light_distance": float(scene.light.distance),
    }
    return info if scene.near_events is None else info | scene.near_events._asdict()


def ending(ego: EgoState, arrived: bool, terminated: bool, truncated: bool) -> str:
    """How an episode has ended, for ``info["ending"]``; "" while it goes on.

    "crash", "arrived", "missed turn", "removed" (by SUMO), "off road", "own rule" (of a subclass, or a red light), or
    "time".
    """
    if not terminated:
        return "time" if truncated else ""
    if ego.crashed or arrived:
        return "crash" if ego.crashed else "arrived"
    place = ego.scene.place if ego.scene is not None else None
    return (place.ended if place is not None else "") or ("own rule" if ego.on_road else "off road")


def on_its_way(place: Place) -> dict[str, Any]:
    """What ``info`` has beside on a network with SUMO's own traffic."""
    return {
        "missed_turn": place.ended == "missed turn",
        "removed": place.ended == "removed",
        "red_light": place.red_light,
        "vehicles_waiting": place.waiting,
        "fuel": place.fuel,
        "electricity": place.electricity,
        "overlap": place.overlap,
    }


def seeds_of(envs: VectorEnv, seed: int | Sequence[int | None] | None) -> list[int | None]:
    """A seed for each environment: an integer means seed, seed + 1, ...; ValueError: too many or too few."""
    if seed is None or isinstance(seed, int | np.integer):
        return [None if seed is None else int(seed) + index for index in range(envs.num_envs)]
    if len(seed) != envs.num_envs:
        raise ValueError(f"{envs.num_envs} seeds are needed, not a list of length={len(seed)}")
    return list(seed)


def actions_of(envs: VectorEnv, actions: Any) -> NDArray[Any]:
    """One action for each environment; ValueError if they are none. Whether numbers are actions is looked at later."""
    actions = np.asarray(actions)
    if isinstance(envs.single_action_space, gym.spaces.Box):
        known = actions.shape == envs.action_space.shape
    else:
        known = np.issubdtype(actions.dtype, np.integer) and envs.action_space.contains(actions)
    if not known:
        raise ValueError(f"actions must be {envs.num_envs} of {envs.single_action_space}, not {actions}")
    return actions
