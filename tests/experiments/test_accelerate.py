"""The faster highway-env drives the episodes of the original to the last bit."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from highway_env.road.regulation import RegulatedRoad
from highway_env.utils import has_corner_inside
from highway_env.vehicle.kinematics import Vehicle

from experiments.backends import make_env
from experiments.backends.highway_env_vehicle import PathVehicle, ScenarioVehicle
from experiments.study.grid import TRAFFICS
from experiments.validation import contacts
from experiments.validation.accelerate import FastRoad, within_reach
from experiments.validation.episodes import Recorder
from experiments.validation.stage import open_env
from sumo_env.tasks import TASKS, get_task

TRAFFIC = {  # few enough vehicles for the original
    "highway": {"vehicles_count": 12, "vehicles_density": 2.0},
    "two-way": {"vehicles_count": 8},
    "roundabout": {"vehicles_count": 8},
    "intersection": {},
    "u-turn": {"vehicles_count": 6},
}
RUNS: dict[
    str, tuple[tuple[int, str], ...]
] = {  # seeds and egos that meet lane changes, cut-ins, swerves and wrecks
    "highway": ((5, "random"), (2, "random")),
    "two-way": ((9, "SLOWER"), (3, "random")),
    "roundabout": ((7, "random"), (2, "random")),
    "intersection": ((0, "random"), (1, "random")),
    "u-turn": ((1, "random"), (3, "random")),
}


ANGLES = np.random.default_rng(0).uniform(-7.0, 7.0, 1000)
# What the accelerated road promises: compiled code calls the C library, highway-env calls numpy.
pytestmark = pytest.mark.skipif(
    any(f(ANGLES).tolist() != list(map(g, ANGLES)) for f, g in ((np.sin, math.sin), (np.cos, math.cos))),
    reason="numpy's sine is not the C library's on this processor: episodes are the same to rounding only",
)


def original(task: str, config: dict[str, Any]) -> Any:
    env = make_env("highway-env", task, config)
    env.unwrapped.task = within_reach(task)  # type: ignore[attr-defined]
    return env


def frames(env: Any, task: str, traffic: str, seed: int, ego: str = "random") -> list[Any]:
    """Everything that an episode shows and measures, step by step; `ego`: random actions, or always this one."""
    rng = np.random.default_rng(seed)
    observation, info = env.reset(seed=seed, options={"config": {"risk": TRAFFICS[traffic]}})
    inner = env.unwrapped
    recorder = Recorder(task, get_task(task).road(inner.config))
    seen, done = [(observation, 0.0, info, inner.scene)], False
    recorder.see(inner.scene)
    numbers = {name: number for number, name in inner.actions.items()}
    while not done:
        action = numbers.get(ego, int(rng.integers(len(numbers))))
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.see(inner.scene)
        seen.append((observation, reward, info, inner.scene))
        done = terminated or truncated
    env.close()
    return [*seen, recorder.row()]


def assert_same(first: list[Any], second: list[Any]) -> None:
    assert len(first) == len(second)
    for (observation, reward, info, scene), (other, other_reward, other_info, other_scene) in zip(
        first[:-1], second[:-1], strict=True
    ):
        np.testing.assert_array_equal(observation, other)
        assert reward == other_reward
        assert info == other_info
        assert scene.ids == other_scene.ids
        for name in ("x", "y", "speed", "heading", "crashed"):
            np.testing.assert_array_equal(getattr(scene, name), getattr(other_scene, name), name)
    assert str(first[-1]) == str(second[-1])  # nan where nothing was measured


@pytest.mark.parametrize("traffic", ["regular", "risky"])
@pytest.mark.parametrize("task", TASKS)
def test_episodes_are_those_of_the_original(task: str, traffic: str) -> None:
    config = {**next(iter(TASKS[task].levels.values())), **TRAFFIC[task], "variant": "path", "duration": 8}
    for seed, ego in RUNS[task]:
        first, second = (
            frames(make(task, config), task, traffic, seed, ego)
            for make in (original, lambda *of: open_env("highway-env", *of))
        )
        assert_same(first, second)


@pytest.mark.parametrize("variant", ["v0", "connected"])
def test_other_variants_and_frequencies(variant: str) -> None:
    config = {"vehicles_count": 6, "variant": variant, "simulation_frequency": 10, "duration": 6}
    first = frames(original("u-turn", config), "u-turn", "regular", 1)
    assert_same(first, frames(open_env("highway-env", "u-turn", config), "u-turn", "regular", 1))


def test_roads_are_the_fast_ones() -> None:
    env: Any = open_env("highway-env", "intersection", {})
    env.reset(seed=0)
    assert isinstance(env.unwrapped.road, FastRoad)
    env.close()


def test_a_swerve_ends_as_in_the_original() -> None:
    config = {"vehicles_count": 3, "simulation_frequency": 10}
    ends = []
    for env in (original("two-way", config), open_env("highway-env", "two-way", config)):
        env.reset(seed=0)
        road = env.unwrapped.road
        driver = max(road.vehicles[1:], key=lambda v: (v.lane_index == ("a", "b", 1), v.position[0]))
        driver.swerve(("a", "b", 0))
        for _ in range(40):
            road.act()
            road.step(0.1)
        ends.append((driver.lane_index, driver.target_lane_index, driver.position.tolist(), driver.crashed))
        env.close()
    assert ends[0] == ends[1]
    assert ends[1][1] == ("a", "b", 1)


@pytest.mark.parametrize("task", ["highway", "u-turn"])
def test_accelerations_are_those_of_the_original(task: str) -> None:
    env: Any = open_env("highway-env", task, {})
    env.reset(seed=0)
    env.step(1)
    vehicles = env.unwrapped.road.vehicles[:12]
    for vehicle in vehicles[1:]:
        fast, slow = type(vehicle), PathVehicle if task == "u-turn" else ScenarioVehicle
        for other in (*vehicles, None):
            for ego in (vehicle, vehicles[0], None):
                found = vehicle.acceleration(ego, other)
                vehicle.__class__ = slow
                assert found == vehicle.acceleration(ego, other)
                vehicle.__class__ = fast
    env.close()


def test_conflicts_are_those_of_the_original() -> None:
    config = list(TASKS["intersection"].levels.values())[-1]
    env: Any = open_env("highway-env", "intersection", config)
    env.reset(seed=0)
    road, rng = env.unwrapped.road, np.random.default_rng(0)
    n = len(road.vehicles)
    possible = 0
    for _ in range(12):
        for vehicle in road.vehicles:
            vehicle.lane_index = vehicle.route[0]
            vehicle.lane = road.network.get_lane(vehicle.lane_index)
            vehicle.position = vehicle.lane.position(rng.uniform(70, 100), rng.uniform(-1, 1))
            vehicle.speed = rng.uniform(0, 10)
        found = road.conflicts()
        for i in range(n):
            for j in range(i + 1, n):
                expected = RegulatedRoad.is_conflict_possible(road.vehicles[i], road.vehicles[j])
                assert bool(expected) == found[i, j]
                possible += bool(expected)
    env.close()
    assert 20 < possible < 12 * n * (n - 1) / 4


def test_predicted_rectangles_meet_as_in_the_original() -> None:
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(400):
        place, other = rng.uniform(-3, 3, 2), rng.uniform(-3, 3, 2)
        heading, turned = rng.uniform(-4, 4, 2)
        expected = has_corner_inside((place, 7.5, 1.8, heading), (other, 7.5, 1.8, turned))
        inside.append(expected)
        assert contacts.has_point_inside(*place, heading, *other, turned) == expected
    assert 50 < sum(inside) < 350


def test_collisions_are_those_of_the_original() -> None:
    rng = np.random.default_rng(0)
    collided = 0
    for _ in range(1500):
        place, heading = rng.uniform(-100, 100, 2), rng.choice([0.0, rng.uniform(-4, 4)])
        first = Vehicle(None, place, heading, rng.uniform(0, 35))
        second = Vehicle(None, place + rng.uniform(-6, 6, 2), rng.uniform(-4, 4), rng.uniform(0, 35))
        now, soon, way = first._is_colliding(second, 0.1)
        both = (first, second)
        x, y = np.array([vehicle.position for vehicle in both]).T.copy()
        heading, speed = (np.array([getattr(v, name) for v in both]) for name in ("heading", "speed"))
        pairs, touching, ways = contacts.collisions(x, y, heading, speed, 0.1)
        assert len(pairs) == (now or soon)
        if now or soon:
            collided += 1
            assert touching[0] == now
            np.testing.assert_array_equal(ways[0], way if soon else [np.nan, np.nan])
    assert collided > 300
