"""highway-env's LidarObservation: the original on the same traffic, and on SUMO."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import gymnasium as gym
import highway_env  # noqa: F401  (registers its environments)
import numpy as np
import pytest

import sumo_env  # noqa: F401  (likewise)
from sumo_env.env import SumoDrivingEnv
from sumo_env.spaces.lidar import Lidar
from tests.processes import ROOT
from tests.sumo_env.replica.pairs import episode

LIDAR: dict[str, Any] = {"type": "LidarObservation"}
RAMP = ROOT / "examples" / "scenarios" / "networks" / "ramp.net.xml"
FINE: dict[str, Any] = {**LIDAR, "cells": 90, "maximum_range": 137.5, "normalize": False}
IDS = ["highway-fast-v0", "two-way-v0", "roundabout-v1", "intersection-v2", "u-turn-v1", "merge-v1"]


@pytest.mark.slow
@pytest.mark.parametrize("beams", [LIDAR, FINE, {**LIDAR, "cells": 3, "maximum_range": 30}], ids=str)
@pytest.mark.parametrize("id", IDS)
def test_distances_and_velocities_are_highway_env_s(id: str, beams: dict[str, Any]) -> None:
    """The space, and every sector in every step of an episode in which something is seen; obstacles included."""
    names = gym.spec(id), gym.spec(f"replica/{id}")
    theirs: Any
    ours: Any
    theirs, ours = (gym.make(name, config={"observation": beams}, disable_env_checker=True) for name in names)
    assert theirs.observation_space == ours.observation_space
    nothing, sees = theirs.observation_space.high[0, 0], list[bool]()

    def act(env: Any, rng: np.random.Generator) -> int:
        sees.append(bool((env.observation_type.observe()[:, 0] < nothing).any()))
        return int(rng.integers(env.action_space.n))

    for seed in range(5):
        assert episode(theirs, ours, seed, act) == ""
        if any(sees):
            break
    assert any(sees)


def test_on_a_network_of_one_s_own_the_first_ray_points_ahead() -> None:
    """On a ramp that runs north-east: the ego's half, the gap to the leader, and its speed less the ego's."""
    config = {"observation": {**LIDAR, "normalize": False}, "spawn_probability": 0.6}
    env = SumoDrivingEnv(RAMP, [["ramp", "merge", "out"]], ["ramp", "merge", "out"], config)
    env.reset(seed=3)
    behind_others = 0
    for _ in range(20):
        seen = env.step(1)[0]
        assert env.observation_space.contains(seen)
        scene, leader = env.scene, env.scene.place.neighbours[2]
        row = scene.ids.index(leader.id or "ego")
        if row and leader.gap < 40 and scene.heading[row] == pytest.approx(scene.heading[0]):
            assert scene.heading[0] < -0.1
            expected = leader.gap + scene.size("ego")[0] / 2, leader.speed - scene.speed[0]
            assert seen[0] == pytest.approx(expected, abs=0.01)
            behind_others += 1
    assert behind_others > 3
    env.close()


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
        seen = [
            Lidar(LIDAR, own_axes=own).observe(env._car.situation(env.target_speeds)._replace(scene=each))
            for own, each in ((True, scene), (False, turned), (False, scene))
        ]
        np.testing.assert_allclose(seen[0], seen[1], atol=1e-6)
        assert not np.allclose(seen[0], seen[2])
    env.close()
