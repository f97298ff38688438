"""The types of action with which the agent steers: the replica is highway-env, seed for seed.

`PYTHONPATH=. pytest -m long -s <this file>` drives two hundred episodes of each task and prints those that differ.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from highway_env.envs import RoundaboutEnv, TwoWayEnv
from highway_env.vehicle.controller import MDPVehicle

import sumo_env
from sumo_env.config import warn_once
from sumo_env.replica.env import ReplicaEnv
from tests.tasks import highway_env_task, published_task

from .pairs import EQUAL, SLOW_EQUAL, episode, unfused

FEW = {"highway": 1, "two-way": 2, "roundabout": 1, "intersection": 1, "u-turn": 2}
EACH = 200  # episodes of each task in the long comparison
TABLE = {"type": "Kinematics"}
STEERING: dict[str, Any] = {"type": "ContinuousAction"}
SHORTER = {"highway": {"duration": 12}}  # highway-env needs half a second for each of its steps
QUICK = {"simulation_frequency": 15, "policy_frequency": 5, "duration": 6}
WAYS: list[tuple[str, dict[str, Any]]] = [
    ("intersection", {**STEERING, "lateral": False, "acceleration_range": [-6.0, 3.0]}),
    ("u-turn", {**STEERING, "longitudinal": False, "steering_range": [-0.2, 0.1]}),
    ("roundabout", {**STEERING, "speed_range": [-2.0, 12.0], "clip": False}),
    ("u-turn", {**STEERING, "dynamical": True}),
    ("roundabout", {**STEERING, "dynamical": True}),
    ("roundabout", {"type": "DiscreteAction"}),
    (
        "u-turn",
        {
            "type": "DiscreteAction",
            "actions_per_axis": 4,
            "longitudinal": False,
            "steering_range": [-0.1, 0.1],
        },
    ),
]


class PaidTwoWay(TwoWayEnv):
    """highway-env's, whose reward asks such an ego for a target lane and a target speed, and fails."""

    def _rewards(self, action: Any) -> dict[str, float]:
        return {
            "high_speed_reward": MDPVehicle.get_speed_index(self.vehicle) / 2,
            "left_lane_reward": 1 - self.vehicle.lane_index[2],
        }


class PaidRoundabout(RoundaboutEnv):
    """highway-env's, whose reward asks whether an array of two numbers is 0 or 2, and fails."""

    def _rewards(self, action: Any) -> dict[str, float]:
        return super()._rewards(1 if np.size(action) == 2 else action)


def pair(task: str, config: dict[str, Any], version: int = 0) -> tuple[Any, Any]:
    """highway-env's environment and the replica's."""
    ours = gym.make(gym.spec(f"replica/{task}-v{version}"), config=config)
    if task == "two-way":
        return gym.wrappers.TimeLimit(PaidTwoWay(config), 15), ours
    if task == "roundabout" and not version:
        return PaidRoundabout(config), ours
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


def different(
    task: str,
    seeds: range,
    config: dict[str, Any],
    act: Callable[..., Any],
    version: int = 0,
    slow: float = SLOW_EQUAL,
) -> list[tuple[int, str]]:
    """The episodes that are not those of highway-env: seed, and what differs."""
    envs = pair(
        task, {"observation": TABLE, **config} if version == 0 or task != "intersection" else config, version
    )
    found = [(seed, episode(*envs, seed, act, slow)) for seed in seeds]
    return [entry for entry in found if entry[1]]


# -- the same seed -------------------------------------------------------------------------------------------------


@pytest.mark.slow
@published_task  # on the merge, which has no time limit, a wild episode need not end
def test_a_steered_episode_is_that_of_highway_env(task: str) -> None:
    few, config = FEW[task], {"action": STEERING}
    assert different(task, range(few), {**config, **SHORTER.get(task, {})}, wild) == []
    quick = {key: value for key, value in QUICK.items() if key != "duration" or task != "two-way"}
    assert different(task, range(few), {**config, **quick}, along_the_road) == []


@pytest.mark.slow
@pytest.mark.parametrize(("task", "action"), WAYS, ids=str)
def test_every_way_to_steer(action: dict[str, Any], task: str) -> None:
    """Also among cars that are not far from the ego, that give way to it, and on two lanes around a bend."""
    assert different(task, range(2), {"action": action}, wild) == []


@pytest.mark.slow
@pytest.mark.parametrize("id", sumo_env.LATER_IDS)
def test_later_versions_are_those_of_highway_env(id: str) -> None:
    """Defaults, observations, actions, rewards; one of three episodes goes on with the stream of the one before."""
    task, version = sumo_env.task_of(id), sumo_env.version_of(id)
    theirs, ours = pair(task, {}, version)
    assert (theirs.observation_space, theirs.action_space) == (ours.observation_space, ours.action_space)
    connected = "neighbour_vehicles_connected_lanes"
    assert (
        theirs.unwrapped.config[connected]
        == ours.unwrapped.config[connected]
        == (id != "replica/intersection-v1")
    )
    found = [(seed, what) for seed in range(3) if (what := episode(theirs, ours, seed, wild))]
    assert found == []


@pytest.mark.long
@highway_env_task
def test_steered_episodes_are_the_same_in_99_percent(task: str) -> None:
    """To 1e-6 throughout, half of them under any action and half along the road."""
    quick = {key: value for key, value in QUICK.items() if key != "duration" or task != "two-way"}
    config = {"action": STEERING, **SHORTER.get(task, {})}
    found = different(task, range(1000, 1000 + EACH // 2), config, wild, slow=EQUAL)
    found += different(
        task, range(2001, 2001 + EACH // 2), {"action": STEERING, **quick}, along_the_road, slow=EQUAL
    )
    print(f"{task}: {EACH - len(found)} of {EACH} episodes the same", *found, sep="\n")
    assert len(found) <= 0.01 * EACH


@pytest.mark.long
@pytest.mark.parametrize(("slow", "rounds_alike"), [(SLOW_EQUAL, False), (EQUAL, True)])
@pytest.mark.parametrize("id", sumo_env.LATER_IDS)
def test_later_versions_are_the_same_in_99_percent(
    id: str, slow: float, rounds_alike: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To 1e-6 throughout where highway-env rounds as the replica does; else but for cars that crawl, `pairs.SLOW`."""
    if rounds_alike:
        unfused(monkeypatch)
    envs = pair(sumo_env.task_of(id), {}, sumo_env.version_of(id))
    found = [
        (seed, what) for seed in range(1000, 1000 + EACH) if (what := episode(*envs, seed, wild, slow=slow))
    ]
    print(f"{id}: {EACH - len(found)} of {EACH} episodes the same to {slow}", *found, sep="\n")
    assert len(found) <= 0.01 * EACH


# -- the type of action --------------------------------------------------------------------------------------------


def test_copies_and_scenarios_go_on_as_the_original() -> None:
    env: Any = gym.make(gym.spec("replica/intersection-v1")).unwrapped
    env.reset(seed=4)
    for _ in range(3):
        env.step([0.2, 0.1])
    twin = copy.deepcopy(env)
    again: Any = ReplicaEnv("intersection", version=1)
    again.reset(options={"scenario": env.scenario})
    for _ in range(3):
        again.step([0.2, 0.1])
    for action in ([1.0, 0.0], [0.0, 0.3]):
        result = env.step(action)[0]
        np.testing.assert_array_equal(twin.step(action)[0], result)
        np.testing.assert_array_equal(again.step(action)[0], result)


def test_info_and_the_ego_are_as_in_highway_env() -> None:
    env: Any = gym.make("replica/highway-v0", config={"action": STEERING}).unwrapped
    _, info = env.reset(seed=0)
    assert info["action"].tolist() == [0.0, 0.0]
    info = env.step(np.array([0.5, -0.25], np.float32))[-1]
    assert info["action"].dtype == np.float32 and info["action"].tolist() == [0.5, -0.25]
    assert env.action_type.space() == env.action_space and env.actions == {}
    assert not hasattr(env.vehicle, "target_speed") and env.vehicle.lane_index[:2] == ("0", "1")
    assert env.get_available_actions() == []


def test_grids_of_speeds_are_not_in_highway_env_either() -> None:
    warn_once.cache_clear()
    with pytest.warns(UserWarning, match="'speed_range' has no effect on the action type 'DiscreteAction'"):
        gym.make("replica/highway-v0", config={"action": {"type": "DiscreteAction", "speed_range": [0, 1]}})
