"""The types of action with which the agent steers: the replica is highway-env, seed for seed.

`PYTHONPATH=. pytest -m long -s <this file>` drives two hundred episodes of each task and prints those that differ.
"""

import math
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from highway_env.envs import MergeEnv, RoundaboutEnv, TwoWayEnv
from highway_env.vehicle.controller import MDPVehicle

import sumo_env
from tests.tasks import OF_HIGHWAY_ENV, published_task

from .pairs import EQUAL, SLOW_EQUAL, different

FEW = {"highway": 1, "two-way": 2, "roundabout": 1, "intersection": 1, "u-turn": 2}
EACH = 200  # episodes of each task in the long comparison
TABLE = {"type": "Kinematics"}
STEERING: dict[str, Any] = {"type": "ContinuousAction"}
STEPS = {"type": "DiscreteAction"}
SHORTER = {"highway": {"duration": 7}}  # highway-env needs half a second for each of its steps
WAYS: list[tuple[str, dict[str, Any]]] = [
    ("intersection", {**STEERING, "lateral": False, "acceleration_range": [-6.0, 3.0]}),
    ("u-turn", {**STEERING, "longitudinal": False, "steering_range": [-0.2, 0.1]}),
    ("roundabout", {**STEERING, "speed_range": [-2.0, 12.0], "clip": False}),
    ("u-turn", {**STEERING, "dynamical": True}),
    ("roundabout", {**STEERING, "dynamical": True}),
    ("roundabout", STEPS),
    ("u-turn", {**STEPS, "actions_per_axis": 4, "longitudinal": False, "steering_range": [-0.1, 0.1]}),
]


class PaidTwoWay(TwoWayEnv):
    """highway-env's, whose reward asks such an ego for a target lane and a target speed, and fails."""

    def _rewards(self, action: Any) -> dict[str, float]:
        return {
            "high_speed_reward": MDPVehicle.get_speed_index(self.vehicle) / 2,
            "left_lane_reward": 1 - self.vehicle.lane_index[2],
        }


class Paid:
    """Over highway-env's, whose reward asks whether an array of two numbers is 0 or 2, and fails."""

    def _rewards(self, action: Any) -> dict[str, float]:
        rewards: Any = super()
        return rewards._rewards(1 if np.size(action) == 2 else action)


class PaidRoundabout(Paid, RoundaboutEnv):
    """highway-env's, paid."""


class PaidMerge(Paid, MergeEnv):
    """highway-env's, paid."""


PAID = {"roundabout": PaidRoundabout, "merge": PaidMerge}


def pair(task: str, config: dict[str, Any], version: int = 0) -> tuple[Any, Any]:
    """highway-env's environment and the replica's."""
    ours = gym.make(gym.spec(f"replica/{task}-v{version}"), config=config)
    if task == "two-way":
        return gym.wrappers.TimeLimit(PaidTwoWay(config), 15), ours
    if task in PAID and not version:
        return PAID[task](config), ours
    return gym.make(gym.spec(f"{task}-v{version}"), config=config), ours


def wild(env: Any, rng: np.random.Generator) -> Any:
    """Any action."""
    return rng.integers(env.action_space.n) if hasattr(env.action_space, "n") else uniform(env, rng)


def uniform(env: Any, rng: np.random.Generator) -> np.ndarray:
    """Numbers a little beyond the space too."""
    return rng.uniform(-1.1, 1.1, env.action_space.shape).astype(np.float32)


def along_the_road(env: Any, rng: np.random.Generator) -> np.ndarray:
    """Keeps the lane, more or less, and lives longer: accelerates at random, and steers to the middle of the lane."""
    car = env.vehicle
    s, lat = car.lane.local_coordinates(car.position)
    off = (car.heading - car.lane.heading_at(s + 0.3 * car.speed) + math.pi) % (2 * math.pi) - math.pi
    angle = (-off - 0.05 * lat) * 5.0 / max(abs(car.speed), 1.0) + rng.normal() * 0.02
    pedals = rng.uniform(-0.6, 0.7)
    return np.array([pedals, angle / (math.pi / 4)], np.float32)


def quick(task: str) -> dict[str, int]:
    """Frequencies, and the duration where the task has one."""
    config = {"simulation_frequency": 15, "policy_frequency": 5}
    return config if task in ("two-way", "merge") else {**config, "duration": 6}


def steered(task: str, config: dict[str, Any]) -> tuple[Any, Any]:
    return pair(task, {"observation": TABLE, **config})


# -- the same seed -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@published_task  # on the merge, which has no time limit, a wild episode need not end
def test_a_steered_episode_is_that_of_highway_env(task: str) -> None:
    few, config = FEW[task], {"action": STEERING}
    assert different(*steered(task, {**config, **SHORTER.get(task, {})}), range(few), wild) == []
    assert different(*steered(task, {**config, **quick(task)}), range(few), along_the_road) == []


@pytest.mark.slow
@pytest.mark.parametrize(("task", "action"), WAYS, ids=str)
def test_every_way_to_steer(action: dict[str, Any], task: str) -> None:
    """Also among cars that are not far from the ego, that give way to it, and on two lanes around a bend."""
    assert different(*steered(task, {"action": action}), range(1), wild) == []


@pytest.mark.slow
@pytest.mark.parametrize("id", sumo_env.LATER_IDS)
def test_later_versions_are_those_of_highway_env(id: str) -> None:
    """Observations and rewards, under the defaults; the second episode goes on with the stream of the one before."""
    task, version = sumo_env.task_of(id), sumo_env.version_of(id)
    theirs, ours = pair(task, {}, version)
    assert different(theirs, ours, (1, 2), wild) == []


MANY: list[tuple[str, int, Any]] = [*product(OF_HIGHWAY_ENV, [0], [wild, along_the_road])]
MANY.remove(("merge", 0, wild))  # it has no time limit, and a wild episode need not end
MANY += [(sumo_env.task_of(id), sumo_env.version_of(id), wild) for id in sumo_env.LATER_IDS]


@pytest.mark.long
@pytest.mark.parametrize(("task", "version", "act"), MANY)
def test_many_steered_episodes_are_the_same_in_99_percent(task: str, version: int, act: Any) -> None:
    config = {"action": STEERING, **SHORTER.get(task, {}), **({} if act is wild else quick(task))}
    envs = pair(task, {}, version) if version else steered(task, config)
    found = different(*envs, range(1000, 1000 + EACH), act, SLOW_EQUAL if version else EQUAL)
    print(f"{task}-v{version}: {EACH - len(found)} of {EACH} episodes the same", *found, sep="\n")
    assert len(found) <= 0.01 * EACH
