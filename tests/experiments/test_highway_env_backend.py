"""highway-env driven by scenarios: its own code on our traffic, and the interface of `sumo_env`."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import highway_env
import numpy as np
import pytest
from highway_env.vehicle.behavior import IDMVehicle

from experiments.backends import make_env
from experiments.backends.highway_env import ScenarioEnv
from experiments.backends.highway_env_vehicle import PathVehicle, distance_beyond
from sumo_env.traffic.risk import RiskEvent
from tests.tasks import OF_HIGHWAY_ENV, highway_env_task

SMALL: dict[str, Any] = {"vehicles_count": 12}
BASE_ATTRIBUTES = ("COMFORT_ACC_MAX", "COMFORT_ACC_MIN", "DISTANCE_WANTED", "TIME_WANTED", "DELTA", "ACC_MAX")


def make(task: str, **config: Any) -> ScenarioEnv:
    small = SMALL if task == "highway" else {}
    env: Any = make_env("highway-env", task, {**small, **config}).unwrapped
    return env


# -- the same traffic as SUMO's ------------------------------------------------------------------------------


@pytest.mark.parametrize("risk", [0.0, 1.0])
@highway_env_task
def test_a_seed_is_the_same_scenario_with_the_same_interface_in_both_simulators(
    task: str, risk: float
) -> None:
    config = {"risk": risk, **(SMALL if task == "highway" else {})}
    ours, theirs = (make_env(backend, task, config) for backend in ("sumo", "highway-env"))
    for seed in (3, None, None):
        infos = [(ours.reset(seed=seed)[1], theirs.reset(seed=seed)[1])]
        # how often a second is computed is each simulator's own
        mine, other = (env.get_wrapper_attr("scenario") for env in (ours, theirs))
        assert replace(mine, simulation_frequency=other.simulation_frequency) == other
        infos += [(ours.step(1)[4], theirs.step(1)[4]) for _ in range(2)]
        for mine, other in infos:
            assert {k: type(v) for k, v in mine.items()} == {k: type(v) for k, v in other.items()}
            assert mine["rewards"].keys() == other["rewards"].keys()
    ours.close()
    for name in ("actions", "target_speeds", "observation_space", "action_space"):
        assert getattr(ours.unwrapped, name) == getattr(theirs.unwrapped, name)
    theirs_config = theirs.get_wrapper_attr("config")
    config = ours.get_wrapper_attr("config")
    config = {k: v for k, v in config.items() if k not in ("simulation_frequency", "action")}
    assert config.items() <= theirs_config.items()


def test_no_task_changes_the_class_of_the_drivers() -> None:
    before = {name: getattr(IDMVehicle, name) for name in BASE_ATTRIBUTES}
    for task in OF_HIGHWAY_ENV:
        env = make(task, risk=1.0)
        env.reset(seed=0)
        env.step(1)
    assert {name: getattr(IDMVehicle, name) for name in BASE_ATTRIBUTES} == before


# -- highway-env's own code; whole episodes are compared in tests/sumo_env/replica/test_same_seed.py -------------------


def test_the_ego_has_crashed_with_a_wreck_though_another_car_is_nearer() -> None:
    env = make("highway")
    env.reset(seed=0)
    ego, near, wreck = env.road.vehicles[:3]
    near.position, wreck.position = (ego.position + np.array([gap, 0.0]) for gap in (6.0, 9.0))
    ego.crashed = wreck.crashed = True
    env.scene = env._scene()
    env._measure()
    assert env.crash and env.crash.other == wreck.id


def on_u_turn(env: ScenarioEnv, lane: tuple[str, str, int], s: float, speed: float) -> PathVehicle:
    vehicle = PathVehicle.make_on_lane(env.road, lane, s, speed)
    vehicle.plan_route_to("d")
    return vehicle


def test_a_leader_round_the_bend_is_as_far_as_the_way_to_it_and_as_fast_as_it_drives() -> None:
    env = make("u-turn")
    env.reset(seed=0)
    follower = on_u_turn(env, ("b", "c", 0), 2.0, 10.0)
    leader = on_u_turn(env, ("c", "d", 0), 15.0, 10.0)
    arc = env.road.network.get_lane(("b", "c", 0)).length
    assert distance_beyond(follower, leader) == pytest.approx(arc - 2.0 + 15.0)
    gap = follower.DISTANCE_WANTED + follower.TIME_WANTED * 10.0
    free = IDMVehicle.acceleration(follower, follower)
    expected = free - follower.COMFORT_ACC_MAX * (gap / (arc + 13.0)) ** 2
    assert follower.acceleration(follower, leader) == pytest.approx(expected)
    # projected on the follower's lane and heading the same leader is oncoming, and nearer
    assert IDMVehicle.acceleration(follower, follower, leader) < expected - 0.3


@pytest.mark.parametrize("place", [(("b", "c", 0), 30.0), (("b", "c", 1), 40.0), (("a", "b", 0), 100.0)])
def test_a_leader_on_the_same_road_is_measured_as_in_stock_highway_env(place: Any) -> None:
    env = make("u-turn")
    env.reset(seed=0)
    lane, s = place
    follower = on_u_turn(env, lane, s - 20.0, 10.0)
    leader = on_u_turn(env, lane, s, 8.0)
    assert distance_beyond(follower, leader) is None
    assert follower.acceleration(follower, leader) == IDMVehicle.acceleration(follower, follower, leader)


# -- risk: what events do is tested on the replica, which is compared with this backend in whole episodes ----------


def test_a_swerve_that_reaches_the_end_of_the_road_ends_on_the_own_lane() -> None:
    """There highway-env makes the car head for the lane back, which has no neighbour on the right."""
    env = make("two-way", vehicles_count=1, oncoming_vehicles_count=0)
    env.reset(seed=0)
    [vehicle] = [vehicle for vehicle in env.road.vehicles if vehicle.id == "v0"]
    vehicle.position[0] = vehicle.lane.length - 20.0
    env._events = [RiskEvent(0.0, "v0", "cut-in", direction=1)]
    targets = [vehicle.target_lane_index for _ in range(5) if env.step(1)]
    assert targets[0] == ("b", "a", 0)  # it has swerved, and heads for the lane back
    assert targets[-1] == ("a", "b", 1)


# -- what kind of task the two-way road is ---------------------------------------------------------------------------


def crashes(env: Any, action: int, scenarios: int, steps: int) -> int:
    """In how many episodes an action that is always chosen ends in a crash."""
    found = 0
    for seed in range(scenarios):
        env.reset(seed=seed)
        for _ in range(steps):
            *_, terminated, truncated, info = env.step(action)
            if terminated or truncated:
                break
        found += info["crashed"]
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "simulator", ["sumo", *(pytest.param(name, marks=pytest.mark.long) for name in ("highway-env", "stock"))]
)
def test_on_the_two_way_road_every_constant_action_crashes(simulator: str) -> None:
    """README and the task's page: in 30 of 30 regular episodes, SLOWER too; "stock" is highway-env's two-way-v0 itself.

    The stock task has no time limit, so that it gets the 15 s of ours.
    """
    if simulator == "stock":
        gym.register_envs(highway_env)
        env: Any = gym.make("two-way-v0", config={"policy_frequency": 1})
    else:
        env = make_env(simulator, "two-way")
    names = env.unwrapped.action_type.actions if simulator == "stock" else env.unwrapped.actions
    assert names[4] == "SLOWER" and len(names) == 5
    assert {name: crashes(env, action, 30, 15) for action, name in names.items()} == dict.fromkeys(
        names.values(), 30
    )
    env.close()
