"""highway-env's pictures, grids and lidar: the originals on the same traffic, and on SUMO."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its environments)
import numpy as np
import pytest
from highway_env.envs.common.observation import observation_factory

import sumo_env  # noqa: F401  (likewise)
from sumo_env.rendering.scenery import HIGHWAY_ENVS
from sumo_env.scenarios import SumoDrivingEnv
from sumo_env.spaces.lidar import Lidar
from sumo_env.spaces.observation import Kinematics
from tests.processes import ROOT
from tests.sumo_env.replica.pairs import EQUAL, SLOW, SLOW_EQUAL
from tests.sumo_env.rollout import drive

# -- pictures ------------------------------------------------------------------------------------------------------

PICTURES: dict[str, Any] = {"type": "GrayscaleObservation", "observation_shape": (128, 64), "stack_size": 4}
PICTURES |= {"weights": [0.2989, 0.5870, 0.1140], "scaling": 1.75}
EDGE = 4  # [px] at the edge of a picture, where one car may be in it and the other one not yet
NEAR = 3  # [px] between the same car in both: one rounds where the other one cuts off and turns a picture of the car


GREYS = HIGHWAY_ENVS.in_grey(np.array(PICTURES["weights"]))


def cars(picture: np.ndarray) -> np.ndarray:
    """Where there is neither ground nor a line, as rows of column and row."""
    return np.argwhere((picture != 0) & (picture != GREYS.ground) & (picture != GREYS.line))


@pytest.mark.slow
@pytest.mark.parametrize("id", ["highway-fast-v0", "roundabout-v1", "u-turn-v1"])
def test_pictures_are_highway_env_s(id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Space, type and order of the pictures are the same, and cars are at the same pixels."""
    monkeypatch.delenv("SDL_VIDEODRIVER", raising=False)  # highway-env draws nothing for "dummy"
    config = {"observation": {**PICTURES, "observation_shape": (160, 96), "scaling": 4.0}}
    theirs: Any = gym.make(gym.spec(id), config=config, disable_env_checker=True)
    ours: Any = gym.make(gym.spec(f"replica/{id}"), config=config)
    assert theirs.observation_space == ours.observation_space
    seen = theirs.reset(seed=1)[0], ours.reset(seed=1)[0]
    for _ in range(6):
        assert seen[0].dtype == seen[1].dtype and seen[0].shape == seen[1].shape
        for pair in zip(*seen, strict=True):
            for one, other in (pair, pair[::-1]):
                here, there = cars(one), cars(other)
                here = here[((here >= EDGE) & (here < np.array(one.shape) - EDGE)).all(axis=1)]
                apart = np.abs(here[:, None] - there).max(axis=2).min(axis=1, initial=99)
                assert one.any() == other.any() and (apart <= NEAR).all()
        middle = [{*pictures[-1][20:-20, 20:-20].ravel().tolist()} for pictures in seen]
        assert {GREYS.ego, GREYS.crashed} & middle[0] == {GREYS.ego, GREYS.crashed} & middle[1] != set()
        seen = theirs.step(1)[0], ours.step(1)[0]


@pytest.mark.parametrize("id", ["sumo/u-turn-v0", "replica/u-turn-v0"])
def test_the_newest_picture_is_the_last_and_pictures_change_nothing(id: str) -> None:
    env, plain = (gym.make(id, config={"observation": kind}) for kind in (PICTURES, {"type": "Kinematics"}))
    for seed in range(2):
        before, _ = env.reset(seed=seed)
        plain.reset(seed=seed)
        assert not before[:-1].any() and before[-1].any()
        for (seen, *result), (_, *expected) in zip(drive(env, 0), drive(plain, 0), strict=True):
            assert env.observation_space.contains(seen) and result[:3] == expected[:3]
            assert np.array_equal(seen[:-1], before[1:]) and not np.array_equal(seen[-1], before[-1])
            before = seen


def test_an_agent_does_not_see_who_is_in_an_event() -> None:
    """In films such cars are yellow."""
    env: Any = gym.make("sumo/u-turn-v0", config={"risk": 1.0, "observation": PICTURES}).unwrapped
    env.reset(seed=0)
    seen = env.observation_type.observe()[-1]
    object.__setattr__(env.scene, "in_event", frozenset(env.scene.ids))
    assert np.array_equal(env.observation_type.observe()[-1], seen)


# -- grids ---------------------------------------------------------------------------------------------------------

GRID: dict[str, Any] = {"type": "OccupancyGrid"}
FEATURES = ["on_road", "presence", "x", "vx", "vy", "cos_h", "sin_h", "heading", "cos_d", "sin_d", "lat_off"]
GRIDS: list[dict[str, Any]] = [
    GRID,
    {
        **GRID, "features": FEATURES, "align_to_vehicle_axes": True, "grid_size": [[-40, 60], [-21, 20]],
        "grid_step": [3, 2], "features_range": {"vx": [-30, 30], "x": [-60, 60]},
    },
    {**GRID, "as_image": True, "features": ["presence", "on_road", "vx"]},
    {  # so coarse that cars share cells
        **GRID, "clip": False, "features_range": {"vy": [-2, 3]}, "grid_size": [[-61, 59], [-21.3, 18.7]],
        "grid_step": [40, 10],
    },
]  # fmt: skip


class All:
    """Looks at highway-env's environment in several ways, at the moment when it looks itself."""

    def __init__(self, env: Any, kinds: list[dict[str, Any]]) -> None:
        self.kinds = [observation_factory(env, kind) for kind in kinds]

    def observe(self) -> list[np.ndarray]:
        return [kind.observe() for kind in self.kinds]


def side_by_side(id: str, kinds: list[dict[str, Any]], seed: int) -> Iterator[tuple[float, Any, Any]]:
    """What highway-env and the replica show in each of these ways in every step of an episode, after the spaces.

    Before them, by how much they may differ.
    """
    theirs: Any = gym.make(gym.spec(id), disable_env_checker=True).unwrapped
    ours: list[Any] = [gym.make(gym.spec(f"replica/{id}"), config={"observation": kind}) for kind in kinds]
    theirs.reset(seed=seed)
    theirs.observation_type = All(theirs, kinds)
    for kind, env in zip(theirs.observation_type.kinds, ours, strict=True):
        assert kind.space() == env.observation_space
    rng, over, equal = np.random.default_rng(seed), False, EQUAL
    expected, found = theirs.observation_type.observe(), [env.reset(seed=seed)[0] for env in ours]
    while not over:
        if min(abs(vehicle.speed) for vehicle in theirs.road.vehicles) < SLOW:
            equal = SLOW_EQUAL
        assert [one.dtype for one in expected] == [other.dtype for other in found]
        yield equal, expected, found
        action = int(rng.integers(theirs.action_space.n))
        expected, _, terminated, truncated, _ = theirs.step(action)
        found, over = [env.step(action)[0] for env in ours], terminated or truncated


# -- lidar ---------------------------------------------------------------------------------------------------------

LIDAR: dict[str, Any] = {"type": "LidarObservation"}
RAMP = ROOT / "examples" / "scenarios" / "networks" / "ramp.net.xml"
GOAL: dict[str, Any] = {"features": ["cos_d", "sin_d"]}
FAR = {**LIDAR, "cells": 90, "maximum_range": 137.5, "normalize": False}
LIDARS: list[dict[str, Any]] = [LIDAR, FAR, {**LIDAR, "cells": 3, "maximum_range": 30}]
# Whether grids are compared there as well.
IDS = {"highway-fast-v0": True, "two-way-v0": False, "roundabout-v1": True, "intersection-v2": True}
IDS |= {"u-turn-v1": True, "merge-v1": False}


def shows(kind: dict[str, Any], seen: np.ndarray) -> Any:
    """Which layers of a grid, or whether a lidar, shows something."""
    if kind in GRIDS:
        return seen.reshape(len(seen), -1).any(axis=1)
    return (seen[:, 0] < (1.0 if kind.get("normalize", True) else kind["maximum_range"])).any()


@pytest.mark.slow
@pytest.mark.parametrize("id", IDS)
def test_grids_and_lidars_are_highway_env_s(id: str) -> None:
    """Every layer and sector, with its space, in every step of episodes until each shows something.

    Also in a bend, where cars come and go, and of obstacles.
    """
    kinds, has_no_goals = [*LIDARS, *(GRIDS if IDS[id] else ())], "highway" in id
    names = [kind.get("features", [""]) for kind in kinds]
    shown: list[Any] = [[has_no_goals and name in GOAL["features"] for name in each] for each in names]
    for seed in range(5):
        for equal, expected, found in side_by_side(id, kinds, seed):
            for kind, one, other in zip(kinds, expected, found, strict=True):
                within = 1.0 if equal == SLOW_EQUAL and kind.get("as_image") else equal
                rtol = 1e-5 if kind in GRIDS else 1e-6
                np.testing.assert_allclose(other.astype(float), one.astype(float), rtol=rtol, atol=within)
            shown = [some | shows(*seen) for some, *seen in zip(shown, kinds, found, strict=True)]
        if (seed or not IDS[id]) and all(map(np.all, shown)):
            break
    assert all(map(np.all, shown))


def test_on_a_network_of_one_s_own_the_first_ray_points_ahead() -> None:
    """On a ramp that runs north-east: the ego's half, the gap to the leader, and its speed less the ego's.

    Likewise ahead is where the way ends, as a table sees it.
    """
    config = {"observation": {**LIDAR, "normalize": False}, "spawn_probability": 0.6}
    env = SumoDrivingEnv(RAMP, [["ramp", "merge", "out"]], ["ramp", "merge", "out"], config)
    env.reset(seed=3)
    behind_others, last = 0, env.task.road(env.config).lane(("out:from", "out:to", 0))
    end, table = np.array(last.position(last.length, 0.0)), Kinematics(GOAL, 1, on_its_way=True)
    for _ in range(20):
        seen = env.step(1)[0]
        assert env.observation_space.contains(seen)
        scene, leader = env.scene, env.scene.place.neighbours[2]
        turn = np.arctan2(*(end - (scene.x[0], scene.y[0]))[::-1]) - scene.heading[0]
        goal = table.observe(env._car.situation(env.target_speeds))[0]
        assert goal == pytest.approx((np.cos(turn), np.sin(turn)), abs=1e-5)
        row = scene.ids.index(leader.id or "ego")
        if row and leader.gap < 40 and scene.heading[row] == pytest.approx(scene.heading[0]):
            assert scene.heading[0] < -0.1
            expected = leader.gap + scene.size("ego")[0] / 2, leader.speed - scene.speed[0]
            assert seen[0] == pytest.approx(expected, abs=0.01)
            behind_others += 1
    assert behind_others > 3


def test_sectors_turn_with_the_ego_in_its_axes() -> None:
    env: Any = gym.make("sumo/intersection-v0", config={"observation": LIDAR}).unwrapped
    for seed in range(3):
        env.reset(seed=seed)
        for _ in range(3):
            env.step(1)
        scene = env.scene
        turn = np.exp(-1j * scene.heading[0])
        places = (scene.x + 1j * scene.y) * turn
        turned = replace(scene, x=places.real, y=places.imag, heading=scene.heading - scene.heading[0])
        assert abs(scene.heading[0]) > 0.1
        situation, ways = (
            env._car.situation(env.target_speeds),
            ((True, scene), (False, turned), (False, scene)),
        )
        seen = [Lidar(LIDAR, own_axes=own).observe(situation._replace(scene=one)) for own, one in ways]
        np.testing.assert_allclose(seen[0], seen[1], atol=1e-6)
        assert not np.allclose(seen[0], seen[2])
